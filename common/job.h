/* job: what to render (settings) and the pieces it is cut into (units).
 *
 * A unit is a pure function of (scene blob, settings, tile, first sample, sample count): whoever renders it,
 * whenever, gets the same bits. The image is cut into square tiles of `tile_size` pixels, row by row from the
 * top left; tiles at the right and bottom rim may be smaller.
 *
 * Sample indices are split into two halves, even and odd. Each half has random numbers of its own, so the two
 * half images are independent and their difference measures the noise (see film.h).
 */
#ifndef LIGHTMILL_JOB_H
#define LIGHTMILL_JOB_H

#include "common/light_groups.h"

typedef enum {
    INTEGRATOR_BDPT = 1,
    INTEGRATOR_PATH = 2,
    INTEGRATOR_LIGHT = 3,
    INTEGRATOR_AO = 4, /* ambient occlusion */
    INTEGRATOR_VCM = 5 /* vertex connection and merging: consistent, but not unbiased */
} integrator_t;
typedef enum { SAMPLER_SOBOL = 1, SAMPLER_INDEPENDENT = 2 } sampler_kind_t;

enum { FILM_DEFAULT_SCALE = 32, FILM_MIN_SCALE = 0, FILM_MAX_SCALE = 40 }; /* of film_scale, below */

enum {
    JOB_MAX_RESOLUTION = 32768,     /* pixels a side */
    JOB_MAX_PIXELS = 1 << 27,       /* pixels in all: 128 Mi */
    JOB_MAX_GROUP_PIXELS = 1 << 28, /* times light groups */
    JOB_MAX_SPP = 1 << 30,          /* samples a pixel; the film counts them in 32 bits */
    JOB_MAX_DEPTH = 100,
    JOB_MIN_TILE = 8,
    JOB_MAX_TILE = 256,
    JOB_MEAN_BOOST = 4, /* an adaptive job gives a tile a power of two of its round's base samples, up to */
    JOB_MAX_BOOST = 16, /* this, and to all of them in the mean the other (master/schedule/next_round.h) */
    JOB_MAX_ADAPTIVE_SPP = JOB_MAX_SPP / JOB_MAX_BOOST,
    JOB_MAX_SAVES = 64, /* sample counts in save_at */
    JOB_MAX_MERGE_RADIUS = 1000000,
    JOB_PHOTON_RUN = 2,     /* of vcm: units keep to runs of so many samples (job_run_end) */
    JOB_MAX_NAME = 200,     /* bytes */
    JOB_MAX_PRIORITY = 1000 /* and as low as minus this */
};

/* Sample counts at which an image is kept, the milestones of a job: rising. */
typedef struct {
    uint32_t count;
    uint32_t spp[JOB_MAX_SAVES]; /* samples a pixel */
} save_at_t;

typedef struct {
    integrator_t integrator;
    sampler_kind_t sampler;
    uint64_t seed;
    int32_t width, height;          /* pixels */
    int32_t max_depth;              /* as pbrt counts: paths of at most max_depth + 1 segments */
    uint32_t spp;                   /* samples a pixel; JOB_MAX_SPP when only time_limit ends the job */
    double time_limit;              /* seconds from the first assignment; 0 for none */
    int32_t tile_size;              /* pixels a side */
    int32_t film_scale;             /* film sums count in units of 2^-film_scale (film_sums.h) */
    int32_t strategy_s, strategy_t; /* of bdpt: only paths of so many light and eye vertices; both 0: all */
    bool unweighted;                /* that strategy without its weight in the combination */
    bool features;                  /* layers of what the eye rays meet first are wanted (film_sums.h) */
    bool learn;                     /* later samples are placed by what earlier ones show (film/learning.h) */
    bool cryptomatte;               /* mattes are wanted (film_sums.h); not with the integrator light */
    double error;      /* the job ends when its estimated relative error is at most this; 0: not (film.h) */
    bool adaptive;     /* noisy tiles get more samples; spp is the mean (master/schedule/next_round.h) */
    save_at_t save_at; /* not with adaptive; what lies beyond spp is never reached */
    char light_groups[LIGHT_GROUPS_TEXT + 1]; /* resolved (light_groups.h); empty: none */
    /* Of vcm: photons are merged within this distance in sample 0, in units of the scene, and within less in
     * later ones; 0: as far as the scene's size on the film says. */
    double merge_radius;
    bool spectral; /* light has wavelengths, not red, green and blue; not with ao and vcm */
} job_settings_t;

/* What is wanted of a job beside its picture. Nothing of it changes a sample. */
typedef struct {
    char name[JOB_MAX_NAME + 1];
    int32_t priority; /* higher goes first; 0 by default */
    double verify;    /* share of the units that are rendered twice and compared, 0 to 1 */
    bool mixed;       /* machines whose bits differ may share it */
    bool halves;      /* images that are kept have the two halves as layers (picture.h) */
} job_terms_t;

typedef struct {
    uint32_t tile;  /* index in the tile grid */
    uint32_t first; /* first sample index */
    uint32_t count; /* samples a pixel, > 0 */
} unit_t;

/* The first sample index behind it. */
static inline uint32_t unit_end(const unit_t *unit)
{
    return unit->first + unit->count;
}

/* A pixel rectangle, [x0, x1) by [y0, y1). */
typedef struct {
    int32_t x0, y0, x1, y1;
} rect_t;

static inline bool rect_has(const rect_t *rect, int32_t x, int32_t y)
{
    return x >= rect->x0 && x < rect->x1 && y >= rect->y0 && y < rect->y1;
}

/* For qsort of what begins with a unit_t: by tiles and first samples. */
int unit_order(const void *a, const void *b);
/* A copy in this order, in fresh memory that the caller frees. */
unit_t *units_sorted(const unit_t *units, size_t count);
/* True when two lists differ in their order at most; none has two units that begin at the same sample. */
bool units_same(const unit_t *a, size_t a_count, const unit_t *b, size_t b_count);
/* RESULT_MISMATCH, naming a sample, when two of the units share it. */
result_t units_check_apart(const unit_t *units, size_t count);

/* Defaults: bdpt, sobol, seed 0, 1280 x 720, depth 8, 64 spp, tiles of 32, FILM_DEFAULT_SCALE,
 * with features, learning. */
job_settings_t job_settings_default(void);
/* Checks every field against the limits above; the message names the field, its value and the range. */
result_t job_settings_check(const job_settings_t *settings);
result_t job_terms_check(const job_terms_t *terms);

uint32_t job_tile_count(const job_settings_t *settings);
rect_t job_tile_rect(const job_settings_t *settings, uint32_t tile);
/* True when bdpt has the strategy that joins s light and t eye vertices: t >= 1 and s >= 0, but not s = 0
 * with t = 1, which is no path, nor s = 1 with t = 1, which would see lights directly, as s = 0 with t = 2
 * does. */
bool job_strategy_exists(int s, int t);
/* Pixels of a tile. */
uint32_t job_tile_pixels(const job_settings_t *settings, uint32_t tile);
/* Pixel samples of a unit, */
uint64_t unit_samples(const job_settings_t *settings, const unit_t *unit);
/* and of the whole job; 0 when spp does not end it. */
uint64_t job_total_samples(const job_settings_t *settings);
/* True when the job goes by rounds (master/schedule/next_round.h): they are decided from its film, or end at
 * its milestones. */
bool job_is_planned(const job_settings_t *settings);
/* True when rounds are decided from the film: not all of them end at milestones. */
bool job_follows_noise(const job_settings_t *settings);
/* The first milestone beyond so many samples a pixel; JOB_MAX_SPP + 1 when there is none. */
uint32_t job_next_milestone(const job_settings_t *settings, uint32_t spp);
/* The number of samples that a pixel can have at most: spp, or JOB_MAX_BOOST times it in an adaptive job. */
uint32_t job_sample_limit(const job_settings_t *settings);
/* True when the unit lies inside the job: a tile that exists, 0 < count, first + count <= job_sample_limit.
 */
bool job_unit_valid(const job_settings_t *settings, const unit_t *unit);
/* The first sample index that a unit which begins at `first` had better leave to another: of vcm the samples
 * of all tiles with the same index share one set of photons, which a worker makes for all of them if it gets
 * them one soon after the other. UINT32_MAX: there is none. */
uint32_t job_run_end(const job_settings_t *settings, uint32_t first);
/* RESULT_PROTOCOL, which names the first that is not valid. */
result_t job_check_units(const job_settings_t *settings, const unit_t *units, size_t count);
/* True when the job makes features: they are wanted, and its integrator traces eye rays. */
bool job_has_features(const job_settings_t *settings);
/* True when it makes mattes. */
bool job_has_mattes(const job_settings_t *settings);
/* True when its integrator traces light subpaths, which make splats. */
bool job_has_splats(const job_settings_t *settings);
/* The hash of all that a sample depends on: the scene and the settings that change its value (others only say
 * how many samples there are). Sums may be added when this is the same, whatever number a job bears: a master
 * that lost its data gives the old numbers to new jobs. */
hash_t job_content_hash(const job_settings_t *settings, const hash_t *blob);
/* Samples of half 0 (even indices) or 1 (odd indices) in a unit. */
uint32_t unit_half_count(const unit_t *unit, int half);

const char *integrator_name(integrator_t integrator);
const char *sampler_name(sampler_kind_t sampler);
/* All of them, in the order of the enums, NULL at the end. */
extern const char *const integrator_names[], *const sampler_names[];

#endif
