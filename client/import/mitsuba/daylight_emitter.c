/* daylight_emitter: see daylight_emitter.h. */
#include "client/import/mitsuba/daylight_emitter.h"

#include <math.h>
#include <string.h>

#include "client/import/environment/daylight.h"

static const double pi = 3.14159265358979323846;
static const double radians = 3.14159265358979323846 / 180;
/* From kcd / m^2 to Mitsuba's W / (m^2 sr nm): 683 lm/W, and the sum of the CIE's y over all nm. */
static const double mitsuba_unit = 1000 / (683.002 * 106.8569);

/* ---- where the sun stands ------------------------------------------------------------------------------ */

/* Days since noon of 1 January 2000, universal time. */
static double days_since_2000(int year, int month, int day, double hours)
{
    int shift = (month - 14) / 12;
    int days = 1461 * (year + 4800 + shift) / 4 + 367 * (month - 2 - 12 * shift) / 12 -
               3 * ((year + 4900 + shift) / 100) / 4 + day - 32075;
    return days - 0.5 + hours / 24 - 2451545;
}

void sun_position(int year, int month, int day, double hours, double latitude, double longitude,
                  double *zenith, double *azimuth)
{
    double n = days_since_2000(year, month, day, hours);
    double omega = 2.1429 - 0.0010394594 * n, anomaly = 6.2400600 + 0.0172019699 * n;
    double ecliptic = 4.8950630 + 0.017202791698 * n + 0.03341607 * sin(anomaly) +
                      0.00034894 * sin(2 * anomaly) - 0.0001134 - 0.0000203 * sin(omega);
    double tilt = 0.4090928 - 6.2140e-9 * n + 0.0000396 * cos(omega);
    double ascension = atan2(cos(tilt) * sin(ecliptic), cos(ecliptic));
    double declination = asin(sin(tilt) * sin(ecliptic));
    double sidereal = ((6.6974243242 + 0.0657098283 * n + hours) * 15 + longitude) * radians;
    double hour = sidereal - ascension, north = latitude * radians;
    double angle = acos(cos(north) * cos(hour) * cos(declination) + sin(declination) * sin(north));
    *azimuth = atan2(-sin(hour), tan(declination) * cos(north) - sin(north) * cos(hour));
    *zenith = angle + 6371.01 / 149597890 * sin(angle); /* parallax */
}

static result_t read_whole(mitsuba_t *m, const element_t *emitter, const char *name, double low, double high,
                           int *value)
{
    double number = *value;
    TRY(property_number(m, emitter, name, low, high, &number));
    *value = (int)number;
    return result_ok();
}

/* By default three in the afternoon in Tokyo, as in Mitsuba. North is -z, east +x. */
static result_t read_place(mitsuba_t *m, const element_t *emitter, double sun[3])
{
    int year = 2010, month = 7, day = 10;
    double hour = 15, minute = 0, second = 0, latitude = 35.6894, longitude = 139.6917, zone = 9;
    double zenith, azimuth;
    TRY(read_whole(m, emitter, "year", -4000, 9999, &year));
    TRY(read_whole(m, emitter, "month", 1, 12, &month));
    TRY(read_whole(m, emitter, "day", 1, 31, &day));
    TRY(property_number(m, emitter, "hour", -24, 48, &hour));
    TRY(property_number(m, emitter, "minute", 0, 60, &minute));
    TRY(property_number(m, emitter, "second", 0, 60, &second));
    TRY(property_number(m, emitter, "latitude", -90, 90, &latitude));
    TRY(property_number(m, emitter, "longitude", -360, 360, &longitude));
    TRY(property_number(m, emitter, "timezone", -24, 24, &zone));
    double hours = hour - zone + (minute + second / 60) / 60;
    sun_position(year, month, day, hours, latitude, longitude, &zenith, &azimuth);
    sun[0] = sin(azimuth) * sin(zenith);
    sun[1] = cos(zenith);
    sun[2] = -cos(azimuth) * sin(zenith);
    return result_ok();
}

/* The direction towards the sun in the light's space: a unit vector. */
static result_t read_sun(mitsuba_t *m, const element_t *emitter, const affine_t *world_from_light,
                         double sun[3])
{
    double world[3] = {0, 0, 0};
    if (!property_find(emitter, "sunDirection")) return read_place(m, emitter, sun);
    TRY(property_point(m, emitter, "sunDirection", world));
    double length = sqrt(world[0] * world[0] + world[1] * world[1] + world[2] * world[2]);
    if (!(length > 1e-18 && length < 1e18)) return error_at(emitter->at, "sunDirection has no direction");
    for (int i = 0; i < 3; ++i) { /* by the inverse, which is the transpose */
        sun[i] = 0;
        for (int k = 0; k < 3; ++k) sun[i] += world_from_light->m[k][i] * world[k] / length;
    }
    return result_ok();
}

/* The space with the sun over +x. */
static affine_t light_from_sky(const double sun[3])
{
    double level = hypot(sun[0], sun[2]), c = level > 0 ? sun[0] / level : 1,
           s = level > 0 ? sun[2] / level : 0;
    return (affine_t){{{c, 0, -s, 0}, {0, 1, 0, 0}, {s, 0, c, 0}}};
}

/* ---- the emitters -------------------------------------------------------------------------------------- */

/* What an emitter says. */
typedef struct {
    bool has_sky, has_sun;
    double sun[3]; /* towards it, in the light's space */
    double turbidity, sky_scale, sun_scale, sun_radius, stretch;
    daylight_below_t below;
} day_t;

static result_t add_day(mitsuba_t *m, const day_t *day, const affine_t *world_from_light, position_t at)
{
    if (!(day->sun[1] >= 0)) return error_at(at, "the sun is below the horizon, where it gives no light");
    sky_t sky;
    sky_init(&sky, asin(fmin(day->sun[1], 1)) * 180 / pi, day->turbidity);
    const affine_t turned = light_from_sky(day->sun);
    const double unit = mitsuba_unit / (double)sky.scale;
    daylight_t light = {.sky = &sky,
                        .world_from_sky = affine_multiply(world_from_light, &turned),
                        .factor = day->sky_scale * unit,
                        .stretch = day->stretch,
                        .below = day->below,
                        .sun_radius = day->sun_radius * SKY_SUN_RADIUS,
                        .at = at};
    if (day->has_sky) TRY(daylight_add_sky(m->scene, &light));
    light.factor = day->sun_scale * unit;
    return day->has_sun ? daylight_add_sun(m->scene, &light) : result_ok();
}

/* What a sky has besides its sun. */
static result_t read_sky(mitsuba_t *m, const element_t *emitter, day_t *day)
{
    bool fading = false;
    TRY(property_bool(m, emitter, "extend", &fading));
    day->below = fading ? DAYLIGHT_FADING : DAYLIGHT_BLACK;
    property_ignore(emitter, "albedo");
    report_warning(m->report, emitter->at,
                   "the sky is Preetham's here, Hosek and Wilkie's in Mitsuba: it differs most about the sun "
                   "and the horizon, and knows no albedo");
    return result_ok();
}

static result_t read_turbidity(mitsuba_t *m, const element_t *emitter, double *turbidity)
{
    *turbidity = SKY_TURBIDITY;
    TRY(property_number(m, emitter, "turbidity", 1, 10, turbidity));
    if (*turbidity >= 2) return result_ok();
    report_warning(m->report, emitter->at, "a turbidity below 2 is taken for 2");
    *turbidity = 2;
    return result_ok();
}

/* `scale`, or a part's own. */
static result_t read_scale(mitsuba_t *m, const element_t *emitter, const char *own, double *scale)
{
    *scale = 1;
    TRY(property_number(m, emitter, "scale", 0, 1e20, scale));
    return property_number(m, emitter, own, 0, 1e20, scale);
}

result_t daylight_emitter_add(mitsuba_t *m, const element_t *emitter, const affine_t *world_from_light)
{
    day_t day = {.has_sky = strcmp(object_type(emitter), "sun") != 0,
                 .has_sun = strcmp(object_type(emitter), "sky") != 0,
                 .sun_radius = 1,
                 .stretch = 1};
    property_ignore(emitter, "resolution");
    TRY(read_turbidity(m, emitter, &day.turbidity));
    TRY(read_scale(m, emitter, "skyScale", &day.sky_scale));
    TRY(read_scale(m, emitter, "sunScale", &day.sun_scale));
    TRY(property_number(m, emitter, "sunRadiusScale", 0, 100, &day.sun_radius));
    TRY(property_number(m, emitter, "stretch", 1, 2, &day.stretch));
    TRY(read_sun(m, emitter, world_from_light, day.sun));
    if (day.has_sky) TRY(read_sky(m, emitter, &day));
    return add_day(m, &day, world_from_light, emitter->at);
}

result_t daylight_emitter_default(mitsuba_t *m, position_t at)
{
    static const element_t nothing = {.tag = "emitter"};
    static const double y[3] = {0, 1, 0};
    day_t day = {.has_sky = true,
                 .has_sun = true,
                 .turbidity = SKY_TURBIDITY,
                 .sky_scale = 2,
                 .sun_scale = 2,
                 .sun_radius = 15,
                 .stretch = 1,
                 .below = DAYLIGHT_FADING};
    affine_t turn;
    affine_rotation(-120, y, &turn);
    TRY(read_place(m, &nothing, day.sun));
    return add_day(m, &day, &turn, at);
}
