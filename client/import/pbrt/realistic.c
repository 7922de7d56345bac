/* realistic: see realistic.h. A lens file is in mm, and so is the film's diagonal; the camera's space is in
 * metres, in which focusdistance is given. The lens is focused, and its pupils are found, here; the worker
 * traces rays through it. */
#include "client/import/pbrt/realistic.h"

#include "client/import/files/lens_file.h"
#include "client/import/pbrt/state/images.h"
#include "client/import/scene/lens.h"

#include <stdlib.h>
#include <string.h>

static const double millimetre = 1e-3;

/* What the directive says. */
typedef struct {
    const char *file, *aperture;
    double diameter, distance; /* mm, m */
    bool simple;
} wish_t;

static result_t read_wish(pbrt_t *p, params_t *params, wish_t *wish)
{
    bool v3 = p->dialect.dialect == DIALECT_V3;
    *wish = (wish_t){.file = "", .aperture = "", .diameter = 1, .distance = 10, .simple = v3};
    TRY(params_string(params, "lensfile", &wish->file));
    TRY(params_float_in(params, "aperturediameter", 1e-6, 1e6, &wish->diameter));
    TRY(params_float_in(params, "focusdistance", 1e-6, 1e12, &wish->distance));
    if (v3) return params_bool(params, "simpleweighting", &wish->simple);
    return params_string(params, "aperture", &wish->aperture);
}

/* ---- the aperture's shape (v4) ------------------------------------------------------------------------- */

enum { SHAPE_SIDE = 256 };

typedef struct {
    double x, y;
} corner_t;

/* Whether a point lies in a polygon: crossings of a ray to the right (Shimrat 1962, algorithm 112). */
static bool is_inside(const corner_t *corners, int count, double x, double y)
{
    bool inside = false;
    for (int i = 0, k = count - 1; i < count; k = i++) {
        corner_t a = corners[i], b = corners[k];
        if ((a.y > y) != (b.y > y) && x < (b.x - a.x) * (y - a.y) / (b.y - a.y) + a.x) inside = !inside;
    }
    return inside;
}

/* The values of pbrt-v4's own shapes at (x, y) in [-1, 1]^2, up to a factor; y runs down the image. */
static double gaussian_at(double x, double y)
{
    return fmax(0, exp(-x * x - y * y) - exp(-1));
}

static double square_at(double x, double y)
{
    return fabs(x) < 0.5 && fabs(y) < 0.5;
}

static double pentagon_at(double x, double y)
{
    corner_t corners[5];
    for (int i = 0; i < 5; i++) {
        corners[i].x = 0.8 * sin(2 * M_PI * i / 5);
        corners[i].y = 0.8 * cos(2 * M_PI * i / 5);
    }
    return is_inside(corners, 5, x, y);
}

static double star_at(double x, double y)
{
    corner_t corners[10];
    const double inner = cos(72 * M_PI / 180) / cos(36 * M_PI / 180);
    for (int i = 0; i < 10; i++) {
        double r = i % 2 ? 1 : inner;
        corners[i].x = r * cos(M_PI * i / 5);
        corners[i].y = r * sin(M_PI * i / 5);
    }
    return is_inside(corners, 10, x, y);
}

static const struct {
    const char *name;
    double (*at)(double x, double y);
} aperture_shapes[] = {
    {"gaussian", gaussian_at}, {"square", square_at}, {"pentagon", pentagon_at}, {"star", star_at}};

static float *draw_shape(double (*at)(double x, double y))
{
    float *values = mem_alloc(SHAPE_SIDE * SHAPE_SIDE * sizeof *values);
    for (int i = 0; i < SHAPE_SIDE * SHAPE_SIDE; i++)
        values[i] = (float)at(2 * (i % SHAPE_SIDE + 0.5) / SHAPE_SIDE - 1,
                              2 * (i / SHAPE_SIDE + 0.5) / SHAPE_SIDE - 1);
    return values;
}

/* The values of the named shape or image, in fresh memory. */
static result_t read_shape(pbrt_t *p, const char *name, position_t at, float **values, uint32_t size[2])
{
    size[0] = size[1] = SHAPE_SIDE;
    for (size_t i = 0; i < ARRAY_LENGTH(aperture_shapes); i++)
        if (strcmp(name, aperture_shapes[i].name) == 0) {
            *values = draw_shape(aperture_shapes[i].at);
            return result_ok();
        }
    const scene_image_t *image;
    TRY(pbrt_image(p, name, SCENE_GAMMA_OF_FILE, IMAGE_NUMBERS, at, &image));
    blob_image_t record = scene_image_record(p->builder, image->image);
    size[0] = record.width, size[1] = record.height;
    *values = scene_image_greys(p->builder, image->image);
    return result_ok();
}

/* The picture is as bright as with a round aperture: the mean is that of a disc in its square. */
static result_t make_aperture(pbrt_t *p, const char *name, position_t at)
{
    float *values;
    uint32_t size[2];
    double sum = 0;
    TRY(read_shape(p, name, at, &values, size));
    size_t count = (size_t)size[0] * size[1];
    for (size_t i = 0; i < count; i++) sum += (double)values[i];
    double factor = M_PI / 4 * (double)count / sum;
    bool usable = sum > 0 && factor <= 1e6;
    for (size_t i = 0; usable && i < count; i++) values[i] = (float)((double)values[i] * factor);
    if (usable) p->scene.aperture = scene_float_image(p->builder, values, size[0], size[1], 1);
    free(values);
    return usable ? result_ok() : error_at(at, "the aperture's image is black");
}

/* ---- the lens ------------------------------------------------------------------------------------------ */

/* Opens the stop as far as it is asked for. */
static void set_stop(pbrt_t *p, const wish_t *wish, position_t at, blob_lens_element_t *elements,
                     uint32_t count)
{
    float radius = (float)(wish->diameter * millimetre / 2);
    for (uint32_t i = 0; i < count; i++) {
        blob_lens_element_t *stop = &elements[i];
        if (stop->curvature_radius != 0) continue;
        if (radius > stop->aperture_radius)
            report_warning(p->report, at, "aperturediameter %g: %g, the lens's largest, is used",
                           wish->diameter, 2 * (double)stop->aperture_radius / millimetre);
        else
            stop->aperture_radius = radius;
    }
}

/* The film's half sides, which make its window. */
static result_t set_film(pbrt_t *p, position_t at)
{
    double diagonal = p->film_diagonal * millimetre, aspect = (double)p->scene.width / p->scene.height;
    if (!(diagonal >= 1e-6 && diagonal <= 1e3))
        return error_at(at, "the film's diagonal is %g mm, but must be from 1e-3 to 1e6", p->film_diagonal);
    const float y = (float)(diagonal / 2 / hypot(aspect, 1)), x = (float)(aspect * (double)y);
    const float window[4] = {-x, x, -y, y};
    memcpy(p->scene.screen_window, window, sizeof window);
    return result_ok();
}

/* The boxes hold whatever an aperture's image, which has corners, lets through, turned as it may be. */
static bool find_pupils(const pbrt_t *p, const lens_t *lens, blob_pupil_t pupils[LENS_PUPILS])
{
    blob_lens_element_t open[LENS_MAX_ELEMENTS];
    memcpy(open, lens->elements, lens->count * sizeof *open);
    for (uint32_t i = 0; i < lens->count && p->scene.aperture != 0; i++)
        if (open[i].curvature_radius == 0) open[i].aperture_radius *= (float)M_SQRT2;
    return lens_find_pupils(&(lens_t){.elements = open, .count = lens->count},
                            p->film_diagonal * millimetre / 2, pupils);
}

/* pbrt's weights. v3's simple ones are relative to the middle of the film. */
static double exposure_of(const pbrt_t *p, const wish_t *wish, const lens_t *lens, const blob_pupil_t *middle)
{
    double rear = lens_rear(lens), rear_side = 3 * (double)lens->elements[lens->count - 1].aperture_radius;
    double area = (double)(middle->x_max - middle->x_min) * (double)(middle->y_max - middle->y_min);
    double time = p->dialect.dialect == DIALECT_V3 ? p->shutter[1] - p->shutter[0] : 1; /* v4: in the gain */
    if (wish->simple) return 1 / (area > 0 ? area : rear_side * rear_side);
    return time / (rear * rear);
}

static result_t make_lens(pbrt_t *p, const wish_t *wish, position_t at, blob_lens_element_t *elements,
                          uint32_t count)
{
    blob_pupil_t pupils[LENS_PUPILS];
    lens_t lens = {.elements = elements, .count = count};
    double thickness;
    result_t focused =
        lens_focus(&lens, millimetre * millimetre * p->film_diagonal, wish->distance, &thickness);
    if (focused.code != RESULT_OK) return error_at(at, "the lens %s", focused.message);
    elements[count - 1].thickness = (float)thickness;
    if (!(elements[count - 1].thickness > 0) || !find_pupils(p, &lens, pupils))
        return error_at(at, "no light gets through the lens to the film");
    p->scene.lens_exposure = (float)exposure_of(p, wish, &lens, &pupils[0]);
    if (!isfinite(p->scene.lens_exposure)) return error_at(at, "the lens is too small for its weights");
    blob_builder_add(p->builder->blob, BLOB_SECTION_LENS, elements, count);
    blob_builder_add(p->builder->blob, BLOB_SECTION_PUPILS, pupils, LENS_PUPILS);
    p->scene.camera = CAMERA_REALISTIC;
    return result_ok();
}

result_t pbrt_make_realistic(pbrt_t *p, params_t *params)
{
    wish_t wish;
    blob_lens_element_t elements[LENS_MAX_ELEMENTS];
    uint32_t count;
    TRY(read_wish(p, params, &wish));
    position_t at = params_where(params, "lensfile", p->camera_at);
    if (wish.file[0] == '\0') return error_at(at, "the realistic camera needs a \"lensfile\"");
    char *path = pbrt_resolve(p, wish.file);
    result_t result = lens_file_read(path, elements, &count);
    free(path);
    if (result.code != RESULT_OK) return error_at(at, "%s", result.message);
    set_stop(p, &wish, params_where(params, "aperturediameter", p->camera_at), elements, count);
    if (wish.aperture[0] != '\0')
        TRY(make_aperture(p, wish.aperture, params_where(params, "aperture", p->camera_at)));
    TRY(set_film(p, p->film_at.line ? p->film_at : p->camera_at));
    return make_lens(p, &wish, params_where(params, "focusdistance", at), elements, count);
}
