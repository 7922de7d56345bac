/* film_resolve: images and error estimates of the sums of a film (see film.h). */
#include "common/film/film.h"

#include <math.h>
#include <stdlib.h>

/* The estimates of one pixel and channel; the noises are standard errors. */
typedef struct {
    double eye, light, noise, eye_noise;
} estimate_t;

/* `eye` and `splat` are the sums of both halves, `samples` and `light_factor` (pixels / light paths)
 * likewise. */
static estimate_t resolve_value(const double eye[2], const double splat[2], const uint32_t samples[2],
                                const double light_factor[3])
{
    double count = (double)samples[0] + samples[1], half[2] = {0, 0};
    estimate_t estimate = {.eye = (eye[0] + eye[1]) / count,
                           .light = (splat[0] + splat[1]) * light_factor[2]};
    if (samples[0] == 0 || samples[1] == 0) {
        /* Nothing is known of the noise: all of the value is taken to be noise. */
        estimate.noise = fabs(estimate.eye + estimate.light);
        estimate.eye_noise = fabs(estimate.eye);
        return estimate;
    }
    /* Var(sum) of two independent means whose weights are their shares of the samples. */
    double shares = sqrt((double)samples[0] * samples[1]) / count;
    for (int h = 0; h < 2; h++) half[h] = eye[h] / samples[h];
    estimate.eye_noise = shares * fabs(half[0] - half[1]);
    for (int h = 0; h < 2; h++) half[h] += splat[h] * light_factor[h];
    estimate.noise = shares * fabs(half[0] - half[1]);
    return estimate;
}

static bool any_features(const film_t *film, size_t pixels)
{
    for (size_t p = 0; film->sums[SUM_FEATURES] != NULL && p < pixels; p++)
        if (film->sums[SUM_FEATURES][FEATURE_VALUES * p + FEATURE_COUNT] > 0) return true;
    return false;
}

static void resolve_feature(const int64_t *sum, film_image_t *image, size_t p)
{
    /* A peer may have sent any number; only what is above zero divides. */
    double count = (double)sum[FEATURE_COUNT], hits = (double)sum[FEATURE_HITS];
    double per_sample = count > 0 ? ldexp(1.0, -FEATURE_SCALE) / count : 0;
    double per_hit = hits > 0 ? ldexp(1.0, -FEATURE_SCALE) / hits : 0;
    for (size_t c = 0; c < 3; c++) {
        image->albedo[3 * p + c] = (float)((double)sum[FEATURE_ALBEDO + c] * per_sample);
        image->normal[3 * p + c] = (float)((double)sum[FEATURE_NORMAL + c] * per_sample);
        image->position[3 * p + c] = (float)((double)sum[FEATURE_POSITION + c] * per_hit);
    }
    image->depth[p] = (float)((double)sum[FEATURE_DEPTH] * per_hit);
    image->object[p] = (float)sum[FEATURE_OBJECT];
    image->material[p] = (float)sum[FEATURE_MATERIAL];
    image->coverage[p] = count > 0 ? (float)(hits / count) : 0;
}

/* Of `pixels` pixels from `first`. */
static void resolve_features(const film_t *film, film_image_t *image, size_t first, size_t pixels)
{
    float **vectors[] = {&image->albedo, &image->normal, &image->position};
    float **scalars[] = {&image->depth, &image->object, &image->material, &image->coverage};
    for (size_t i = 0; i < ARRAY_LENGTH(vectors); i++) *vectors[i] = mem_zalloc(3 * pixels, sizeof(float));
    for (size_t i = 0; i < ARRAY_LENGTH(scalars); i++) *scalars[i] = mem_zalloc(pixels, sizeof(float));
    for (size_t p = 0; p < pixels; p++)
        resolve_feature(film->sums[SUM_FEATURES] + FEATURE_VALUES * (first + p), image, p);
}

/* What the sums of a film are divided by. */
typedef struct {
    const film_t *film;
    size_t pixels;
    double unit, light_factor[3]; /* pixels / light paths, of the halves and of both */
} divisors_t;

static divisors_t film_divisors(const film_t *film)
{
    double paths[3] = {(double)film->counts.light_paths[0], (double)film->counts.light_paths[1], 0};
    divisors_t divisors = {.film = film,
                           .pixels = (size_t)film->settings.width * (size_t)film->settings.height,
                           .unit = ldexp(1.0, -film->settings.film_scale)};
    paths[2] = paths[0] + paths[1];
    for (int i = 0; i < 3; i++)
        divisors.light_factor[i] = paths[i] > 0 ? (double)divisors.pixels / paths[i] : 0;
    return divisors;
}

/* The estimates of a pixel; false when it has no samples. */
static bool resolve_pixel(const divisors_t *divisors, size_t pixel, estimate_t estimates[3])
{
    const film_t *film = divisors->film;
    size_t pixels = divisors->pixels;
    uint32_t samples[2] = {film->samples[pixel], film->samples[pixels + pixel]};
    if (samples[0] == 0 && samples[1] == 0) return false;
    for (size_t c = 0; c < 3; c++) {
        double eye[2], splat[2];
        for (size_t h = 0; h < 2; h++) {
            eye[h] = (double)film->sums[SUM_EYE][3 * (h * pixels + pixel) + c] * divisors->unit;
            splat[h] = (double)film->sums[SUM_SPLAT][3 * (h * pixels + pixel) + c] * divisors->unit;
        }
        estimates[c] = resolve_value(eye, splat, samples, divisors->light_factor);
    }
    return true;
}

/* One half of a pixel, divided by what it has itself. */
static void resolve_half(const divisors_t *divisors, size_t half, size_t pixel, float rgb[3])
{
    const film_t *film = divisors->film;
    size_t at = half * divisors->pixels + pixel;
    double samples = film->samples[at];
    for (size_t c = 0; c < 3; c++) {
        double eye = samples > 0 ? (double)film->sums[SUM_EYE][3 * at + c] / samples : 0;
        double light = (double)film->sums[SUM_SPLAT][3 * at + c] * divisors->light_factor[half];
        rgb[c] = (float)((eye + light) * divisors->unit);
    }
}

/* An image of each half, of some pixels. */
static void resolve_halves(const divisors_t *divisors, size_t first, size_t count, float *images[2])
{
    const uint32_t *samples = divisors->film->samples + first;
    for (size_t h = 0; h < 2; h++) {
        images[h] = mem_zalloc(3 * count, sizeof(float));
        for (size_t p = 0; p < count; p++)
            if (samples[p] > 0 || samples[divisors->pixels + p] > 0)
                resolve_half(divisors, h, first + p, images[h] + 3 * p);
    }
}

/* An image of each group, of some pixels: what is in its plane of the sums, times a factor that a pixel has,
 * or all have. */
static void resolve_groups(const divisors_t *divisors, sum_kind_t kind, size_t first, size_t count,
                           float *images[LIGHT_GROUPS_MAX])
{
    const film_t *film = divisors->film;
    size_t pixels = divisors->pixels, planes = sum_planes(&film->settings, kind);
    for (size_t g = 0; g < planes; g++) {
        const int64_t *sums = film->sums[kind] + 3 * (pixels * g + first);
        images[g] = mem_zalloc(3 * count, sizeof(float));
        for (size_t p = 0; p < count; p++) {
            double samples = (double)film->samples[first + p] + film->samples[pixels + first + p];
            double factor = kind == SUM_GROUP_EYE ? 1 / samples : divisors->light_factor[2];
            for (size_t c = 0; c < 3 && samples > 0; c++)
                images[g][3 * p + c] = (float)((double)sums[3 * p + c] * divisors->unit * factor);
        }
    }
}

/* What some pixels have beside the picture, if it is wanted. */
static void resolve_beside(const divisors_t *divisors, bool halves, bool groups, size_t first, size_t count,
                           film_image_t *image)
{
    if (halves) resolve_halves(divisors, first, count, image->half);
    if (!groups) return;
    resolve_groups(divisors, SUM_GROUP_EYE, first, count, image->group_eye);
    resolve_groups(divisors, SUM_GROUP_SPLAT, first, count, image->group_light);
}

static void put_estimates(film_image_t *image, size_t p, const estimate_t estimates[3])
{
    for (size_t c = 0; c < 3; c++) {
        image->eye[3 * p + c] = (float)estimates[c].eye;
        image->light[3 * p + c] = (float)estimates[c].light;
        image->sum[3 * p + c] = (float)(estimates[c].eye + estimates[c].light);
        image->noise[3 * p + c] = (float)estimates[c].noise;
    }
}

void film_resolve_rows(const film_t *film, const film_rows_t *rows, film_image_t *image)
{
    int width = film->settings.width, height = rows->y1 - rows->y0;
    size_t first = (size_t)rows->y0 * (size_t)width, pixels = (size_t)height * (size_t)width;
    *image = (film_image_t){.width = width, .height = height};
    float **planes[] = {&image->sum, &image->eye, &image->light, &image->noise};
    for (size_t i = 0; i < ARRAY_LENGTH(planes); i++) *planes[i] = mem_zalloc(3 * pixels, sizeof(float));
    image->samples = mem_zalloc(pixels, sizeof(float));
    if (rows->features && film->sums[SUM_FEATURES] != NULL) resolve_features(film, image, first, pixels);

    divisors_t divisors = film_divisors(film);
    float weight = film->settings.adaptive ? JOB_MEAN_BOOST : 1;
    for (size_t p = 0; p < pixels; p++) {
        estimate_t estimates[3];
        if (!resolve_pixel(&divisors, first + p, estimates)) continue;
        image->samples[p] =
            ((float)film->samples[first + p] + (float)film->samples[divisors.pixels + first + p]) / weight;
        put_estimates(image, p, estimates);
    }
    resolve_beside(&divisors, rows->halves, rows->groups, first, pixels, image);
}

void film_resolve(const film_t *film, film_image_t *image)
{
    int height = film->settings.height;
    film_rows_t all = {.y1 = height,
                       .features = any_features(film, (size_t)film->settings.width * (size_t)height)};
    film_resolve_rows(film, &all, image);
    image->error = film_noise(film, NULL);
}

void film_resolve_extras(const film_t *film, const film_extras_t *extras, film_image_t *image)
{
    divisors_t divisors = film_divisors(film);
    if (extras->mattes != NULL) film_resolve_mattes(film, extras->mattes, image);
    resolve_beside(&divisors, extras->halves, extras->groups, 0, divisors.pixels, image);
}

/* The rows that are looked at: the middle one of every `step`. */
static bool row_counts(int y, int step)
{
    return y % step == step / 2;
}

/* The mean of all values of pixels that have samples, and how many these are. */
static double mean_value(const divisors_t *divisors, int step, size_t *values)
{
    double sum = 0;
    size_t width = (size_t)divisors->film->settings.width;
    *values = 0;
    for (int y = step / 2; y < divisors->film->settings.height; y += step)
        for (size_t p = (size_t)y * width; p < ((size_t)y + 1) * width; p++) {
            estimate_t e[3];
            if (!resolve_pixel(divisors, p, e)) continue;
            for (size_t c = 0; c < 3; c++) sum += e[c].eye + e[c].light;
            *values += 3;
        }
    return *values > 0 ? sum / (double)*values : 0;
}

/* Sums of squares over a tile, relative to what film.h says. */
typedef struct {
    double image, eye;
} tile_noise_t;

static tile_noise_t tile_noise(const divisors_t *divisors, int step, uint32_t tile, double floor)
{
    rect_t rect = job_tile_rect(&divisors->film->settings, tile);
    size_t width = (size_t)divisors->film->settings.width;
    tile_noise_t noise = {0, 0};
    for (int y = rect.y0; y < rect.y1; y++)
        for (int x = rect.x0; row_counts(y, step) && x < rect.x1; x++) {
            estimate_t e[3];
            if (!resolve_pixel(divisors, (size_t)y * width + (size_t)x, e)) continue;
            for (size_t c = 0; c < 3; c++) {
                double value = e[c].eye + e[c].light, brightness2 = value * value + floor * floor;
                noise.image += e[c].noise * e[c].noise / brightness2;
                noise.eye += e[c].eye_noise * e[c].eye_noise / brightness2;
            }
        }
    return noise;
}

static double noise_of_rows(const film_t *film, int step, double *eye_noise)
{
    divisors_t divisors = film_divisors(film);
    uint32_t tiles = job_tile_count(&film->settings);
    size_t values;
    double mean = mean_value(&divisors, step, &values), sum = 0;
    for (uint32_t t = 0; t < tiles; t++) {
        tile_noise_t noise = {0, 0};
        if (mean > 0) noise = tile_noise(&divisors, step, t, FILM_ERROR_FLOOR * mean);
        if (eye_noise != NULL) eye_noise[t] = noise.eye;
        sum += noise.image;
    }
    return mean > 0 ? sqrt(sum / (double)values) : INFINITY;
}

double film_noise(const film_t *film, double *eye_noise)
{
    return noise_of_rows(film, 1, eye_noise);
}

double film_noise_of_rows(const film_t *film, size_t pixels)
{
    size_t width = (size_t)film->settings.width, height = (size_t)film->settings.height;
    size_t step = (width * height + pixels - 1) / pixels;
    return noise_of_rows(film, step < height ? (int)step : film->settings.height, NULL);
}

void film_image_free(film_image_t *image)
{
    free(image->sum);
    free(image->eye);
    free(image->light);
    free(image->noise);
    free(image->samples);
    float *features[] = {image->albedo, image->normal,   image->position, image->depth,
                         image->object, image->material, image->coverage};
    for (size_t i = 0; i < ARRAY_LENGTH(features); i++) free(features[i]);
    for (size_t h = 0; h < 2; h++) free(image->half[h]);
    for (int k = 0; k < MATTE_KINDS; k++)
        for (int l = 0; l < MATTE_LEVELS; l++) free(image->mattes[k][l]);
    for (size_t g = 0; g < LIGHT_GROUPS_MAX; g++) {
        free(image->group_eye[g]);
        free(image->group_light[g]);
    }
    *image = (film_image_t){0};
}
