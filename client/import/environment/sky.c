/* sky: see sky.h. Equation numbers and tables are those of Preetham, Shirley and Smits (1999). */
#include "client/import/environment/sky.h"

#include "client/import/files/spectrum.h"
#include "client/import/files/spectrum_data.h"

static const double pi = 3.14159265358979323846;
static const double ground_albedo = 0.2;
/* Of the sun outside the atmosphere, on a surface that faces it, in klx (CIE 85, 1989, rounded). */
static const double solar_illuminance = 128;

/* ---- the sky (their appendix A.2) ---------------------------------------------------------------------- */

/* Perez' distribution at the angle whose cosine is `up` from the zenith, `gamma` from the sun (equation 3).
 */
static double distribution(const sky_perez_t *p, double up, double gamma)
{
    double cosine = cos(gamma);
    return (1 + p->a * exp(p->b / up)) * (1 + p->c * exp(p->d * gamma) + p->e * cosine * cosine);
}

static void set_scale(sky_perez_t *p, double zenith, double sun)
{
    p->scale = zenith / distribution(p, 1, sun);
}

/* A cubic in the sun's angle from the zenith, whose coefficients are quadratic in the turbidity. */
static double zenith_chromaticity(const double m[3][4], double turbidity, double sun)
{
    double t[3] = {turbidity * turbidity, turbidity, 1}, sum = 0;
    for (int i = 0; i < 3; ++i) sum += t[i] * (((m[i][0] * sun + m[i][1]) * sun + m[i][2]) * sun + m[i][3]);
    return sum;
}

static void set_sky(sky_t *sky)
{
    static const double x[3][4] = {{0.00166, -0.00375, 0.00209, 0},
                                   {-0.02903, 0.06377, -0.03202, 0.00394},
                                   {0.11693, -0.21196, 0.06052, 0.25886}};
    static const double y[3][4] = {{0.00275, -0.00610, 0.00317, 0},
                                   {-0.04214, 0.08970, -0.04153, 0.00516},
                                   {0.15346, -0.26756, 0.06670, 0.26688}};
    double t = sky->turbidity, sun = sky->sun_angle, chi = (4.0 / 9 - t / 120) * (pi - 2 * sun);
    sky->luminance = (sky_perez_t){.a = 0.1787 * t - 1.4630,
                                   .b = -0.3554 * t + 0.4275,
                                   .c = -0.0227 * t + 5.3251,
                                   .d = 0.1206 * t - 2.5771,
                                   .e = -0.0670 * t + 0.3703};
    sky->x = (sky_perez_t){.a = -0.0193 * t - 0.2592,
                           .b = -0.0665 * t + 0.0008,
                           .c = -0.0004 * t + 0.2125,
                           .d = -0.0641 * t - 0.8989,
                           .e = -0.0033 * t + 0.0452};
    sky->y = (sky_perez_t){.a = -0.0167 * t - 0.2608,
                           .b = -0.0950 * t + 0.0092,
                           .c = -0.0079 * t + 0.2102,
                           .d = -0.0441 * t - 1.6537,
                           .e = -0.0109 * t + 0.0529};
    set_scale(&sky->luminance, (4.0453 * t - 4.9710) * tan(chi) - 0.2155 * t + 2.4192, sun);
    set_scale(&sky->x, zenith_chromaticity(x, t, sun), sun);
    set_scale(&sky->y, zenith_chromaticity(y, t, sun), sun);
}

/* Linear sRGB (IEC 61966-2-1); what lies outside of it is 0. */
static rgb_t from_chromaticity(double luminance, double x, double y)
{
    double cx = luminance * x / y, cz = luminance * (1 - x - y) / y;
    double r = 3.2406 * cx - 1.5372 * luminance - 0.4986 * cz;
    double g = -0.9689 * cx + 1.8758 * luminance + 0.0415 * cz;
    double b = 0.0557 * cx - 0.2040 * luminance + 1.0570 * cz;
    return vec3((float)fmax(r, 0), (float)fmax(g, 0), (float)fmax(b, 0));
}

/* In kcd / m^2, above the horizon. Perez' formula divides by the cosine: it is taken a tenth of a degree
 * above the horizon at least. */
static rgb_t sky_luminance(const sky_t *sky, const double w[3])
{
    double up = fmax(w[1], 0.0017);
    double gamma = acos(fmin(fmax(w[0] * sky->sun[0] + w[1] * sky->sun[1] + w[2] * sky->sun[2], -1), 1));
    return from_chromaticity(sky->luminance.scale * distribution(&sky->luminance, up, gamma),
                             sky->x.scale * distribution(&sky->x, up, gamma),
                             sky->y.scale * distribution(&sky->y, up, gamma));
}

rgb_t sky_radiance(const sky_t *sky, const double w[3])
{
    return w[1] > 0 ? v_scale(sky_luminance(sky, w), sky->scale) : sky->ground;
}

/* ---- the sun (their appendix A.1) ---------------------------------------------------------------------- */

enum { SUN_FIRST = 380, SUN_STEP = 10, SUN_COUNT = 38, OZONE_FIRST = 450, OZONE_COUNT = 33 };

/* What the atmosphere leaves of the sun's light at a wavelength in nm: scattering by air (Rayleigh) and by
 * haze (Angstrom), absorption by ozone (0.35 cm of it). Water vapour and other gases absorb where the eye
 * sees next to nothing, beyond 689 nm: they are left out. `mass` is the way through the air, 1 at the zenith.
 */
static double transmittance(double lambda, double turbidity, double mass)
{
    /* per cm, from 450 nm by 10 nm */
    static const double ozone[OZONE_COUNT] = {0.003, 0.006, 0.009, 0.014, 0.021, 0.030, 0.040, 0.048, 0.063,
                                              0.075, 0.085, 0.103, 0.120, 0.120, 0.115, 0.125, 0.120, 0.105,
                                              0.090, 0.079, 0.067, 0.057, 0.048, 0.036, 0.028, 0.023, 0.018,
                                              0.014, 0.011, 0.010, 0.009, 0.007, 0.004};
    double micron = lambda / 1000, haze = 0.04608 * turbidity - 0.04586;
    double depth = 0.008735 * pow(micron, -4.08) + haze * pow(micron, -1.3);
    int i = (int)((lambda - OZONE_FIRST) / SUN_STEP);
    if (lambda >= OZONE_FIRST && i < OZONE_COUNT) depth += 0.35 * ozone[i];
    return exp(-depth * mass);
}

/* Kasten's formula for the way through the air at an angle from the zenith (their appendix A.1). */
static double air_mass(double sun)
{
    return 1 / (cos(sun) + 0.15 * pow(93.885 - sun * 180 / pi, -1.253));
}

/* Of light of these powers, from 380 nm by 10 nm. */
static double luminous(const double power[SUN_COUNT])
{
    double sum = 0;
    for (int i = 0; i < SUN_COUNT; ++i)
        sum += power[i] * cie_observer[1][SUN_FIRST - CIE_FIRST + i * SUN_STEP];
    return sum;
}

/* Its illuminance on a surface that faces it, in klx; *colour has luminance 1. */
static double sun_illuminance(const sky_t *sky, rgb_t *colour)
{
    /* Their table 2, from 380 nm by 10 nm; only its shape counts here. */
    static const double outside[SUN_COUNT] = {
        165.5, 162.3, 211.2, 258.8, 258.2, 242.3, 267.6, 296.6, 305.4, 300.6, 306.6, 288.3, 287.1,
        278.2, 271.0, 272.3, 263.6, 255.0, 250.6, 253.1, 253.5, 251.3, 246.3, 241.7, 236.8, 232.1,
        228.2, 223.4, 219.7, 215.3, 211.0, 207.3, 202.4, 198.7, 194.3, 190.7, 186.3, 182.6};
    double lambda[SUN_COUNT], here[SUN_COUNT];
    for (int i = 0; i < SUN_COUNT; ++i) {
        lambda[i] = SUN_FIRST + SUN_STEP * i;
        here[i] = outside[i] * transmittance(lambda[i], sky->turbidity, air_mass(sky->sun_angle));
    }
    spectrum_t spectrum = {.lambda = lambda, .value = here, .count = SUN_COUNT};
    *colour = spectrum_colour(&spectrum, SPECTRUM_EMISSION, SPECTRUM_PBRT_V4);
    return solar_illuminance * luminous(here) / luminous(outside);
}

/* ---- both ---------------------------------------------------------------------------------------------- */

/* What falls from the sky on flat ground, in klx for each channel: sums over rings of equal width. */
static rgb_t flat_illuminance(const sky_t *sky)
{
    enum { RINGS = 90, SECTORS = 180 };
    double sum[3] = {0, 0, 0};
    for (int i = 0; i < RINGS; ++i) {
        double theta = (i + 0.5) * pi / 2 / RINGS, cosine = cos(theta), sine = sin(theta);
        double weight = sine * cosine * (pi / 2 / RINGS) * (2 * pi / SECTORS);
        for (int k = 0; k < SECTORS; ++k) {
            double phi = (k + 0.5) * 2 * pi / SECTORS;
            rgb_t from = sky_luminance(sky, (double[3]){sine * cos(phi), cosine, sine * sin(phi)});
            sum[0] += weight * (double)from.x;
            sum[1] += weight * (double)from.y;
            sum[2] += weight * (double)from.z;
        }
    }
    return vec3((float)sum[0], (float)sum[1], (float)sum[2]);
}

void sky_init(sky_t *sky, double elevation, double turbidity)
{
    double sun = (90 - elevation) * pi / 180;
    *sky = (sky_t){.turbidity = turbidity, .sun_angle = sun, .sun = {sin(sun), cos(sun), 0}};
    set_sky(sky);
    rgb_t colour;
    double beam = sun_illuminance(sky, &colour);
    rgb_t flat = v_mad(flat_illuminance(sky), (float)(beam * fmax(cos(sun), 0)), colour);
    sky->illuminance = (double)rgb_luminance(flat);
    sky->scale = (float)(pi / sky->illuminance);
    sky->sun_irradiance = v_scale(colour, (float)beam * sky->scale);
    sky->ground = v_scale(flat, (float)(ground_albedo / pi) * sky->scale);
}
