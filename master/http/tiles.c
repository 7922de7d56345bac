/* tiles: see tiles.h.
 *
 * DESIGN. Pyramids are immutable once they are made, and only the thread makes and frees them. It makes one
 * without the lock and puts it in its place under the lock; who answers copies tiles under the lock. So a
 * watcher waits for a copy at most, never for a film. Only the layers that somebody looks at are kept, since
 * a resolved film takes more than ten times as much.
 *
 * The farm is asked for a job's version (its number of merged batches) under its own lock, for a moment. The
 * film is resolved as the image writer does it: merges of that one job wait for it, which is another reason
 * for TILES_SHARE. */
#include "master/http/tiles.h"

#include "common/thread.h"

#include <errno.h>
#include <math.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>

/* A layer of a job that is watched. */
typedef struct {
    double asked; /* when somebody asked for it last; 0: nobody has */
    uint32_t version;
    bool absent; /* the job's image is there, but has no such layer */
    pyramid_t *pyramid;
} watched_layer_t;

typedef struct {
    uint64_t job; /* 0: vacant */
    int width, height;
    double asked;
    double ready;   /* when a layer that is not there yet may be made, */
    double refresh; /* and when those that are may be made anew */
    watched_layer_t layers[LAYERS];
} watch_t;

struct tiles {
    tiles_options_t options;
    char *data_dir;
    pthread_t thread;
    pthread_mutex_t lock; /* guards what follows; the thread alone changes pyramids and vacates watches */
    pthread_cond_t asked;
    bool stop;
    watch_t watches[TILES_MAX_JOBS];
};

/* ---- snapshots: the thread alone ----------------------------------------------------------------------- */

/* What a snapshot is made of: a film, or the file of a job that is over. */
typedef struct {
    bool from_file;
    film_image_t film;
    image_t file;
    uint32_t version;
} source_t;

static void source_free(source_t *source)
{
    film_image_free(&source->film);
    image_free(&source->file);
}

static result_t source_open(const tiles_t *tiles, job_t *job, source_t *source)
{
    job_report_t report;
    bool over;
    *source = (source_t){.version = (uint32_t)farm_image_version(tiles->options.farm, job, &over)};
    if (!over) return farm_resolve(tiles->options.farm, clock_now(), job, NULL, &source->film, &report);
    char *path = tiles->options.image_path(tiles->data_dir, farm_job_id(job));
    result_t result = image_read_exr(path, &source->file);
    job_settings_t settings = farm_job_settings(tiles->options.farm, job);
    bool fits = source->file.width == settings.width && source->file.height == settings.height;
    if (result.code == RESULT_OK && !fits)
        result = result_fail(RESULT_INPUT, "%.200s has another size than its job", path);
    free(path);
    source->from_file = result.code == RESULT_OK;
    return result;
}

static bool source_layer(const source_t *source, layer_t layer, layer_view_t *view)
{
    return source->from_file ? layer_of_file(&source->file, layer, view)
                             : layer_of_film(&source->film, layer, view);
}

/* Puts a new pyramid in the place of the old one. */
static void replace(tiles_t *tiles, watched_layer_t *layer, pyramid_t *pyramid, uint32_t version, bool absent)
{
    pthread_mutex_lock(&tiles->lock);
    pyramid_t *old = layer->pyramid;
    layer->pyramid = pyramid;
    layer->version = version;
    layer->absent = absent;
    pthread_mutex_unlock(&tiles->lock);
    pyramid_destroy(&old);
}

/* Called with the lock held, as the next one. */
static uint64_t bytes_held(const tiles_t *tiles)
{
    uint64_t bytes = 0;
    for (size_t i = 0; i < TILES_MAX_JOBS; i++)
        for (size_t l = 0; l < LAYERS; l++)
            if (tiles->watches[i].layers[l].pyramid != NULL)
                bytes += pyramid_bytes(tiles->watches[i].width, tiles->watches[i].height);
    return bytes;
}

/* The layer that was not asked for longest, other than this one; NULL: none is left. */
static watched_layer_t *oldest_layer(tiles_t *tiles, const watched_layer_t *but)
{
    watched_layer_t *oldest = NULL;
    for (size_t i = 0; i < TILES_MAX_JOBS; i++)
        for (size_t l = 0; l < LAYERS; l++) {
            watched_layer_t *layer = &tiles->watches[i].layers[l];
            if (layer == but || layer->pyramid == NULL) continue;
            if (oldest == NULL || layer->asked < oldest->asked) oldest = layer;
        }
    return oldest;
}

static void make_room(tiles_t *tiles, const watched_layer_t *wanted, uint64_t bytes)
{
    watched_layer_t *oldest;
    do {
        pthread_mutex_lock(&tiles->lock);
        oldest = bytes_held(tiles) + bytes > TILES_MAX_BYTES ? oldest_layer(tiles, wanted) : NULL;
        pthread_mutex_unlock(&tiles->lock);
        if (oldest != NULL) replace(tiles, oldest, NULL, 0, false);
    } while (oldest != NULL);
}

static void make_layer(tiles_t *tiles, const watch_t *watch, watched_layer_t *layer, layer_t which,
                       const source_t *source)
{
    layer_view_t view;
    if (!source_layer(source, which, &view)) {
        replace(tiles, layer, NULL, source->version, true);
        return;
    }
    make_room(tiles, layer, pyramid_bytes(watch->width, watch->height));
    pyramid_t *pyramid = pyramid_new(&view, source->version, layer->pyramid);
    if (pyramid == NULL) log_warning("job %llu: no memory to show it", (unsigned long long)watch->job);
    replace(tiles, layer, pyramid, pyramid != NULL ? source->version : 0, false);
}

static double thread_seconds(void)
{
    struct timespec time;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

/* The layers of a watch that somebody looks at. */
static void wanted_layers(tiles_t *tiles, const watch_t *watch, bool wanted[LAYERS])
{
    pthread_mutex_lock(&tiles->lock);
    for (int l = 0; l < LAYERS; l++) wanted[l] = watch->layers[l].asked > 0;
    pthread_mutex_unlock(&tiles->lock);
}

static void take_snapshot(tiles_t *tiles, watch_t *watch, job_t *job)
{
    bool wanted[LAYERS];
    wanted_layers(tiles, watch, wanted);
    double start = thread_seconds();
    source_t source;
    result_t result = source_open(tiles, job, &source);
    if (result.code != RESULT_OK) log_debug("nothing to show: %s", result.message);
    for (int l = 0; l < LAYERS && result.code == RESULT_OK; l++)
        if (wanted[l]) make_layer(tiles, watch, &watch->layers[l], (layer_t)l, &source);
    source_free(&source);
    double now = clock_now();
    watch->ready = now + TILES_INTERVAL;
    watch->refresh = now + fmax(TILES_INTERVAL, (thread_seconds() - start) * (1 / TILES_SHARE - 1));
}

/* When a snapshot of the watch is to be made, by the layers that are looked at; INFINITY: there is nothing
 * new. */
static double due(tiles_t *tiles, const watch_t *watch, uint32_t version)
{
    double when = INFINITY;
    bool wanted[LAYERS];
    wanted_layers(tiles, watch, wanted);
    for (int l = 0; l < LAYERS; l++) {
        const watched_layer_t *layer = &watch->layers[l];
        if (!wanted[l] || version == 0 || layer->version == version) continue;
        when = fmin(when, layer->version == 0 ? watch->ready : watch->refresh);
    }
    return when;
}

/* Frees what nobody has asked for lately. */
static void forget_layers(tiles_t *tiles, watch_t *watch, double now)
{
    for (int l = 0; l < LAYERS; l++) {
        watched_layer_t *layer = &watch->layers[l];
        pthread_mutex_lock(&tiles->lock);
        bool old = layer->asked > 0 && now - layer->asked > TILES_KEEP;
        if (old) layer->asked = 0;
        pthread_mutex_unlock(&tiles->lock);
        if (old) replace(tiles, layer, NULL, 0, false);
    }
}

static void vacate(tiles_t *tiles, watch_t *watch)
{
    pthread_mutex_lock(&tiles->lock);
    watch_t old = *watch;
    *watch = (watch_t){0};
    pthread_mutex_unlock(&tiles->lock);
    for (int l = 0; l < LAYERS; l++) pyramid_destroy(&old.layers[l].pyramid);
}

static void tend(tiles_t *tiles, watch_t *watch)
{
    double now = clock_now();
    pthread_mutex_lock(&tiles->lock);
    bool old = now - watch->asked > TILES_KEEP;
    pthread_mutex_unlock(&tiles->lock);
    job_t *job = old ? NULL : farm_pin(tiles->options.farm, watch->job);
    if (job == NULL) {
        vacate(tiles, watch);
        return;
    }
    forget_layers(tiles, watch, now);
    bool over;
    uint32_t version = (uint32_t)farm_image_version(tiles->options.farm, job, &over);
    if (due(tiles, watch, version) <= now) take_snapshot(tiles, watch, job);
    farm_unpin(tiles->options.farm, job);
}

/* Called with the lock held. */
static bool any_watched(const tiles_t *tiles)
{
    bool watched = false;
    for (size_t i = 0; i < TILES_MAX_JOBS; i++) watched |= tiles->watches[i].job != 0;
    return watched;
}

/* Waits for a question; a quarter of a second at most while something is watched. False when all is to end.
 */
static bool wait_for_work(tiles_t *tiles)
{
    struct timespec until;
    clock_gettime(CLOCK_MONOTONIC, &until);
    until.tv_nsec += 250000000;
    if (until.tv_nsec >= 1000000000) {
        until.tv_nsec -= 1000000000;
        until.tv_sec++;
    }
    pthread_mutex_lock(&tiles->lock);
    if (!tiles->stop && any_watched(tiles)) pthread_cond_timedwait(&tiles->asked, &tiles->lock, &until);
    while (!tiles->stop && !any_watched(tiles)) pthread_cond_wait(&tiles->asked, &tiles->lock);
    bool go_on = !tiles->stop;
    pthread_mutex_unlock(&tiles->lock);
    return go_on;
}

static void *tiles_run(void *argument)
{
    tiles_t *tiles = argument;
    while (wait_for_work(tiles))
        for (size_t i = 0; i < TILES_MAX_JOBS; i++) {
            pthread_mutex_lock(&tiles->lock);
            bool watched = tiles->watches[i].job != 0;
            pthread_mutex_unlock(&tiles->lock);
            if (watched) tend(tiles, &tiles->watches[i]);
        }
    return NULL;
}

/* ---- questions ----------------------------------------------------------------------------------------- */

/* The watch of a job, a new one if need be; NULL when all are taken. Called with the lock held. */
static watch_t *find_watch(tiles_t *tiles, uint64_t job, const job_settings_t *settings)
{
    watch_t *vacant = NULL;
    for (size_t i = 0; i < TILES_MAX_JOBS; i++) {
        if (tiles->watches[i].job == job) return &tiles->watches[i];
        if (tiles->watches[i].job == 0) vacant = &tiles->watches[i];
    }
    if (vacant != NULL) *vacant = (watch_t){.job = job, .width = settings->width, .height = settings->height};
    return vacant;
}

/* Called with the lock held. */
static result_t answer(watch_t *watch, layer_t layer, const tile_query_t *query, uint8_t **bytes,
                       size_t *size)
{
    watched_layer_t *watched = &watch->layers[layer];
    watch->asked = watched->asked = clock_now();
    if (watched->absent)
        return result_fail(RESULT_INPUT, "job %llu has no layer %s", (unsigned long long)watch->job,
                           layer_name(layer));
    return pyramid_answer(watched->pyramid, watch->width, watch->height, watched->version, query, bytes,
                          size);
}

/* The settings of a job; false when there is none. */
static bool settings_of(const tiles_t *tiles, uint64_t id, job_settings_t *settings)
{
    job_t *job = farm_pin(tiles->options.farm, id);
    if (job == NULL) return false;
    *settings = farm_job_settings(tiles->options.farm, job);
    farm_unpin(tiles->options.farm, job);
    return true;
}

result_t tiles_get(tiles_t *tiles, uint64_t job, layer_t layer, const tile_query_t *query, uint8_t **bytes,
                   size_t *size)
{
    job_settings_t settings;
    if (!settings_of(tiles, job, &settings))
        return result_fail(RESULT_UNREACHABLE, "there is no job %llu", (unsigned long long)job);
    if (layer_is_feature(layer) && !job_has_features(&settings))
        return result_fail(RESULT_INPUT, "job %llu has no layer %s", (unsigned long long)job,
                           layer_name(layer));
    pthread_mutex_lock(&tiles->lock);
    watch_t *watch = find_watch(tiles, job, &settings);
    if (watch != NULL && watch->layers[layer].pyramid == NULL) pthread_cond_signal(&tiles->asked);
    result_t result =
        watch != NULL
            ? answer(watch, layer, query, bytes, size)
            : result_fail(RESULT_LIMIT, "%d jobs are watched already: try again in a minute", TILES_MAX_JOBS);
    pthread_mutex_unlock(&tiles->lock);
    return result;
}

/* ---- life ---------------------------------------------------------------------------------------------- */

static void tiles_free(tiles_t *tiles)
{
    for (size_t i = 0; i < TILES_MAX_JOBS; i++)
        for (int l = 0; l < LAYERS; l++) pyramid_destroy(&tiles->watches[i].layers[l].pyramid);
    pthread_cond_destroy(&tiles->asked);
    pthread_mutex_destroy(&tiles->lock);
    free(tiles->data_dir);
    free(tiles);
}

result_t tiles_start(const tiles_options_t *options, tiles_t **out)
{
    tiles_t *tiles = mem_zalloc(1, sizeof *tiles);
    tiles->options = *options;
    tiles->data_dir = mem_strdup(options->data_dir);
    cond_init_monotonic(&tiles->asked);
    pthread_mutex_init(&tiles->lock, NULL);
    result_t result = thread_start(&tiles->thread, "lm-tiles", tiles_run, tiles);
    if (result.code == RESULT_OK)
        *out = tiles;
    else
        tiles_free(tiles);
    return result;
}

void tiles_stop(tiles_t **out)
{
    tiles_t *tiles = *out;
    if (tiles == NULL) return;
    pthread_mutex_lock(&tiles->lock);
    tiles->stop = true;
    pthread_cond_signal(&tiles->asked);
    pthread_mutex_unlock(&tiles->lock);
    pthread_join(tiles->thread, NULL);
    tiles_free(tiles);
    *out = NULL;
}
