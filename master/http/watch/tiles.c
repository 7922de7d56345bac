/* tiles: see tiles.h.
 *
 * DESIGN. Only the thread makes, changes and frees pyramids. It resolves a film band by band,
 * so that the memory does not grow with the image, and puts the rows in their place under the lock; who
 * answers copies tiles under the lock. So a watcher waits for a band at most, never for a film, and no second
 * pyramid is needed beside the one that is shown. While a snapshot is made, a watcher may get tiles of the
 * new version and is told the old one: it will be sent them again. Only the layers that somebody looks at are
 * kept.
 *
 * The farm is asked for a job's version (its number of merged batches) under its own lock, for a moment.
 * Merges of the job wait for one band at a time. Bands may be of different moments: what was merged meanwhile
 * is another version, which the next snapshot shows.
 *
 * When there is no room for a layer, the one that nobody has asked for since TILES_HOLD, and longest, goes.
 * When all are being looked at, the new one is refused: layers that push one another out would be made for
 * ever. */
#include "master/http/watch/tiles.h"

#include "common/memory_limit.h"
#include "common/thread.h"

#include <math.h>
#include <pthread.h>
#include <stdlib.h>

/* A layer of a job that is watched. */
typedef struct {
    double asked;     /* when somebody asked for it last; 0: nobody has */
    double next;      /* when it may be made anew */
    uint32_t version; /* 0: it has not been made */
    bool absent;      /* the job's image is there, but has no such layer */
    bool refused;     /* there was no room for it */
    pyramid_t *pyramid;
} watched_layer_t;

typedef struct {
    uint64_t job; /* 0: vacant */
    int width, height;
    double asked;
    double made;     /* when the last snapshot began */
    int failures;    /* in a row, to make one */
    bool unreadable; /* the image of a job that is over */
    watched_layer_t layers[LAYERS];
} watch_t;

struct tiles {
    tiles_options_t options;
    char *data_dir;
    uint64_t max_bytes, max_answers;
    pthread_t thread;
    double ready;         /* when a layer that is not there yet may be made, */
    double refresh;       /* and when those that are may be made anew: the thread's */
    pthread_mutex_t lock; /* guards what follows; the thread alone changes pyramids and vacates watches */
    pthread_cond_t asked;
    bool stop;
    uint64_t unsent; /* bytes of answers */
    double waited;   /* when somebody had waited in vain last */
    watch_t watches[TILES_MAX_JOBS];
};

/* ---- room ---------------------------------------------------------------------------------------------- */

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

/* The layer that was not asked for longest; NULL: all are looked at. */
static watched_layer_t *idle_layer(tiles_t *tiles, double now)
{
    watched_layer_t *idle = NULL;
    for (size_t i = 0; i < TILES_MAX_JOBS; i++)
        for (size_t l = 0; l < LAYERS; l++) {
            watched_layer_t *layer = &tiles->watches[i].layers[l];
            if (layer->pyramid == NULL || now - layer->asked < TILES_HOLD) continue;
            if (idle == NULL || layer->asked < idle->asked) idle = layer;
        }
    return idle;
}

/* Frees a layer until somebody asks for it again. */
static void drop_layer(tiles_t *tiles, watched_layer_t *layer)
{
    pthread_mutex_lock(&tiles->lock);
    pyramid_t *old = layer->pyramid;
    layer->pyramid = NULL;
    layer->version = 0;
    layer->asked = 0;
    layer->refused = false;
    pthread_mutex_unlock(&tiles->lock);
    pyramid_destroy(&old);
}

static bool make_room(tiles_t *tiles, uint64_t bytes)
{
    for (;;) {
        pthread_mutex_lock(&tiles->lock);
        bool room = bytes_held(tiles) + bytes <= tiles->max_bytes;
        watched_layer_t *idle = room ? NULL : idle_layer(tiles, clock_now());
        pthread_mutex_unlock(&tiles->lock);
        if (room || idle == NULL) return room;
        drop_layer(tiles, idle);
    }
}

/* Sees to it that a layer has a pyramid, unless there is no memory for it. */
static void prepare_layer(tiles_t *tiles, const watch_t *watch, watched_layer_t *layer, uint32_t version)
{
    if (layer->pyramid != NULL) return;
    pyramid_t *pyramid = make_room(tiles, pyramid_bytes(watch->width, watch->height))
                             ? pyramid_new(watch->width, watch->height, version)
                             : NULL;
    pthread_mutex_lock(&tiles->lock);
    layer->pyramid = pyramid;
    layer->refused = pyramid == NULL;
    pthread_mutex_unlock(&tiles->lock);
}

/* ---- snapshots: the thread alone ----------------------------------------------------------------------- */

/* What is being made, and of what. */
typedef struct {
    tiles_t *tiles;
    watch_t *watch;
    job_t *job;
    uint32_t version;
    bool over;
    bool wanted[LAYERS]; /* those that are to be made */
} snapshot_t;

static bool wants(const snapshot_t *snapshot, bool (*kind)(layer_t layer))
{
    bool wanted = false;
    for (int l = 0; l < LAYERS; l++) wanted |= snapshot->wanted[l] && kind((layer_t)l);
    return wanted;
}

static bool is_stopped(tiles_t *tiles)
{
    pthread_mutex_lock(&tiles->lock);
    bool stopped = tiles->stop;
    pthread_mutex_unlock(&tiles->lock);
    return stopped;
}

static void put_rows(snapshot_t *snapshot, int l, const layer_view_t *rows, int y)
{
    pthread_mutex_lock(&snapshot->tiles->lock);
    pyramid_put(snapshot->watch->layers[l].pyramid, rows, y, snapshot->version);
    pthread_mutex_unlock(&snapshot->tiles->lock);
}

static result_t read_film(snapshot_t *snapshot)
{
    const watch_t *watch = snapshot->watch;
    int step = int_max(1, TILES_BAND_PIXELS / watch->width);
    bool features = wants(snapshot, layer_is_feature), halves = wants(snapshot, layer_is_half),
         groups = wants(snapshot, layer_is_group);
    for (int y = 0; y < watch->height; y += step) {
        film_image_t image;
        layer_view_t view;
        film_rows_t rows = {y, int_min(y + step, watch->height), features, halves, groups};
        if (is_stopped(snapshot->tiles)) return result_fail(RESULT_CANCELLED, "the master ends");
        TRY(farm_resolve_rows(snapshot->tiles->options.farm, snapshot->job, &rows, &image));
        for (int l = 0; l < LAYERS; l++)
            if (snapshot->wanted[l] && layer_of_film(&image, (layer_t)l, &view))
                put_rows(snapshot, l, &view, y);
        film_image_free(&image);
    }
    return result_ok();
}

/* The file has no such layer, which does not change. */
static void mark_absent(snapshot_t *snapshot, int l)
{
    watched_layer_t *layer = &snapshot->watch->layers[l];
    drop_layer(snapshot->tiles, layer);
    pthread_mutex_lock(&snapshot->tiles->lock);
    layer->absent = true;
    pthread_mutex_unlock(&snapshot->tiles->lock);
    snapshot->wanted[l] = false;
}

static result_t take_file_rows(void *context, const image_t *rows, int y, int height)
{
    snapshot_t *snapshot = context;
    layer_view_t view;
    if (rows->width != snapshot->watch->width || height != snapshot->watch->height)
        return result_fail(RESULT_INPUT, "it has another size than its job");
    if (is_stopped(snapshot->tiles)) return result_fail(RESULT_CANCELLED, "the master ends");
    for (int l = 0; l < LAYERS; l++) {
        if (!snapshot->wanted[l]) continue;
        if (layer_of_file(rows, (layer_t)l, &view))
            put_rows(snapshot, l, &view, y);
        else
            mark_absent(snapshot, l);
    }
    return result_ok();
}

static result_t read_file(snapshot_t *snapshot)
{
    tiles_t *tiles = snapshot->tiles;
    char *path = tiles->options.image_path(tiles->data_dir, snapshot->watch->job);
    result_t result = image_read_exr_rows(path, take_file_rows, snapshot);
    free(path);
    return result;
}

static double thread_seconds(void)
{
    struct timespec time;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

/* Chooses the layers that somebody looks at and that are not of this version. A layer that a file has not
 * got may be in the film, when the job goes on. */
static bool choose_layers(snapshot_t *snapshot)
{
    bool any = false;
    pthread_mutex_lock(&snapshot->tiles->lock);
    for (int l = 0; l < LAYERS; l++) {
        const watched_layer_t *layer = &snapshot->watch->layers[l];
        bool absent = layer->absent && snapshot->over;
        snapshot->wanted[l] = layer->asked > 0 && !absent && layer->version != snapshot->version;
        any |= snapshot->wanted[l];
    }
    pthread_mutex_unlock(&snapshot->tiles->lock);
    return any && snapshot->version != 0;
}

/* The layers are what the snapshot says, and are not made again before their time. */
static void date_layers(snapshot_t *snapshot, const result_t *result, double next)
{
    watch_t *watch = snapshot->watch;
    pthread_mutex_lock(&snapshot->tiles->lock);
    watch->unreadable = result->code != RESULT_OK && snapshot->over;
    for (int l = 0; l < LAYERS; l++) {
        if (!snapshot->wanted[l]) continue;
        watch->layers[l].next = next;
        if (result->code != RESULT_OK) continue;
        watch->layers[l].version = snapshot->version;
        watch->layers[l].absent = false;
    }
    pthread_mutex_unlock(&snapshot->tiles->lock);
}

/* Says once why there is nothing to see; of a film, which may be loaded or freed just now, only when it stays
 * so. Returns how long to wait before the next attempt. */
static double note_failure(const snapshot_t *snapshot, const result_t *result)
{
    watch_t *watch = snapshot->watch;
    int said = snapshot->over ? 0 : 4;
    if (watch->failures == said && result->code != RESULT_CANCELLED)
        log_warning("job %llu cannot be shown: %s", (unsigned long long)watch->job, result->message);
    return ldexp(TILES_INTERVAL, int_min(watch->failures++, 6));
}

/* Sees to the memory of the layers that are wanted. One of them may have made room for another: it is not
 * wanted any more. False when none is left. */
static bool prepare_layers(snapshot_t *snapshot)
{
    watch_t *watch = snapshot->watch;
    bool any = false;
    for (int l = 0; l < LAYERS; l++) {
        if (!snapshot->wanted[l]) continue;
        watch->layers[l].next = watch->made + TILES_INTERVAL;
        prepare_layer(snapshot->tiles, watch, &watch->layers[l], snapshot->version);
    }
    for (int l = 0; l < LAYERS; l++) {
        snapshot->wanted[l] &= watch->layers[l].pyramid != NULL;
        any |= snapshot->wanted[l];
    }
    return any;
}

static void take_snapshot(snapshot_t *snapshot)
{
    tiles_t *tiles = snapshot->tiles;
    watch_t *watch = snapshot->watch;
    double begun = thread_seconds();
    watch->made = clock_now();
    if (!prepare_layers(snapshot)) return;
    result_t result = snapshot->over ? read_file(snapshot) : read_film(snapshot);
    double now = clock_now(), cost = thread_seconds() - begun, pause = fmax(TILES_INTERVAL, 3 * cost);
    if (result.code == RESULT_OK)
        watch->failures = 0;
    else
        pause = fmax(pause, note_failure(snapshot, &result));
    date_layers(snapshot, &result, now + pause);
    tiles->ready = now + 3 * cost;
    tiles->refresh = fmax(tiles->refresh, now + cost * (1 / TILES_SHARE - 1));
}

/* ---- the thread ---------------------------------------------------------------------------------------- */

/* Frees what nobody has asked for lately. */
static void forget_layers(tiles_t *tiles, watch_t *watch, double now)
{
    for (int l = 0; l < LAYERS; l++) {
        pthread_mutex_lock(&tiles->lock);
        double asked = watch->layers[l].asked;
        pthread_mutex_unlock(&tiles->lock);
        if (asked > 0 && now - asked > TILES_KEEP) drop_layer(tiles, &watch->layers[l]);
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

/* The job of a watch, pinned; NULL when there is none, or nobody has asked for it lately. */
static job_t *watched_job(tiles_t *tiles, watch_t *watch, double now)
{
    pthread_mutex_lock(&tiles->lock);
    uint64_t job = watch->job;
    bool old = now - watch->asked > TILES_KEEP;
    pthread_mutex_unlock(&tiles->lock);
    if (job == 0) return NULL;
    job_t *pinned = old ? NULL : farm_pin(tiles->options.farm, job);
    if (pinned == NULL)
        vacate(tiles, watch);
    else
        forget_layers(tiles, watch, now);
    return pinned;
}

/* When the layers of a watch that are there may be made anew. */
static double refresh_time(const snapshot_t *snapshot, double now)
{
    tiles_t *tiles = snapshot->tiles;
    pthread_mutex_lock(&tiles->lock);
    bool busy = now - tiles->waited < TILES_BUSY_INTERVAL;
    pthread_mutex_unlock(&tiles->lock);
    return fmax(tiles->refresh, snapshot->watch->made + (busy ? TILES_BUSY_INTERVAL : 0));
}

/* Is a snapshot of the watch to be made now, by the layers that are looked at? */
static bool is_due(snapshot_t *snapshot, double now)
{
    const tiles_t *tiles = snapshot->tiles;
    const watch_t *watch = snapshot->watch;
    bool due = false;
    if (!choose_layers(snapshot)) return false;
    double refresh = refresh_time(snapshot, now);
    for (int l = 0; l < LAYERS; l++) {
        const watched_layer_t *layer = &watch->layers[l];
        double turn = layer->version == 0 ? tiles->ready : refresh;
        due |= snapshot->wanted[l] && now >= layer->next && now >= turn;
    }
    return due;
}

/* Makes the snapshot that is due, of the watch whose last is oldest; false when none is. */
static bool work(tiles_t *tiles)
{
    farm_t *farm = tiles->options.farm;
    snapshot_t chosen = {0};
    double now = clock_now();
    for (size_t i = 0; i < TILES_MAX_JOBS; i++) {
        snapshot_t snapshot = {.tiles = tiles, .watch = &tiles->watches[i]};
        snapshot.job = watched_job(tiles, snapshot.watch, now);
        if (snapshot.job == NULL) continue;
        snapshot.version = (uint32_t)farm_image_version(farm, snapshot.job, &snapshot.over);
        job_t *not_chosen = snapshot.job;
        if (is_due(&snapshot, now) && (chosen.job == NULL || snapshot.watch->made < chosen.watch->made)) {
            not_chosen = chosen.job;
            chosen = snapshot;
        }
        if (not_chosen != NULL) farm_unpin(farm, not_chosen);
    }
    if (chosen.job == NULL) return false;
    take_snapshot(&chosen);
    farm_unpin(farm, chosen.job);
    return true;
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
    pthread_mutex_lock(&tiles->lock);
    if (!tiles->stop && any_watched(tiles)) cond_wait_until(&tiles->asked, &tiles->lock, clock_now() + 0.25);
    while (!tiles->stop && !any_watched(tiles)) pthread_cond_wait(&tiles->asked, &tiles->lock);
    bool go_on = !tiles->stop;
    pthread_mutex_unlock(&tiles->lock);
    return go_on;
}

static void *tiles_run(void *argument)
{
    tiles_t *tiles = argument;
    while (wait_for_work(tiles))
        while (work(tiles)) {
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

/* Why there is nothing to see of a layer, as far as that is known. Called with the lock held, as the next
 * one. */
static result_t obstacle(const tiles_t *tiles, const watch_t *watch, layer_t layer)
{
    const watched_layer_t *watched = &watch->layers[layer];
    unsigned long long job = watch->job;
    if (watched->absent) return result_fail(RESULT_INPUT, "job %llu has no layer %s", job, layer_name(layer));
    if (watched->version == 0 && watch->unreadable)
        return result_fail(RESULT_INPUT, "the image of job %llu cannot be read: the master's log says why",
                           job);
    if (watched->pyramid == NULL && watched->refused)
        return result_fail(RESULT_LIMIT,
                           "no memory to show the layer %s, which takes %.0f MB: what is watched already and "
                           "this come to more than %.0f MB. Try again when less is watched",
                           layer_name(layer), 1e-6 * (double)pyramid_bytes(watch->width, watch->height),
                           1e-6 * (double)tiles->max_bytes);
    if (tiles->unsent >= tiles->max_answers)
        return result_fail(RESULT_LIMIT, "too many answers are under way to slow readers: try again");
    return result_ok();
}

static result_t answer(tiles_t *tiles, watch_t *watch, layer_t layer, const tile_query_t *query,
                       uint8_t **bytes, size_t *size)
{
    watched_layer_t *watched = &watch->layers[layer];
    watch->asked = watched->asked = clock_now();
    TRY(obstacle(tiles, watch, layer));
    const pyramid_t *pyramid = watched->version != 0 ? watched->pyramid : NULL;
    TRY(pyramid_answer(pyramid, watch->width, watch->height, watched->version, query, bytes, size));
    tiles->unsent += *size;
    return result_ok();
}

void tiles_release(tiles_t *tiles, uint8_t *bytes, size_t size)
{
    free(bytes);
    pthread_mutex_lock(&tiles->lock);
    tiles->unsent -= size;
    pthread_mutex_unlock(&tiles->lock);
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
    if (!layer_of_job(&settings, layer))
        return result_fail(RESULT_INPUT, "job %llu has no layer %s", (unsigned long long)job,
                           layer_name(layer));
    pthread_mutex_lock(&tiles->lock);
    watch_t *watch = find_watch(tiles, job, &settings);
    if (watch != NULL && watch->layers[layer].pyramid == NULL) pthread_cond_signal(&tiles->asked);
    result_t result =
        watch != NULL
            ? answer(tiles, watch, layer, query, bytes, size)
            : result_fail(RESULT_LIMIT, "%d jobs are watched already: try again in a minute", TILES_MAX_JOBS);
    pthread_mutex_unlock(&tiles->lock);
    return result;
}

bool tiles_newer(tiles_t *tiles, uint64_t job, layer_t layer, const tile_query_t *query)
{
    bool newer = false;
    pthread_mutex_lock(&tiles->lock);
    for (size_t i = 0; i < TILES_MAX_JOBS; i++) {
        watch_t *watch = &tiles->watches[i];
        if (watch->job != job) continue;
        watched_layer_t *watched = &watch->layers[layer];
        watch->asked = watched->asked = clock_now();
        newer = watched->version != 0 && watched->version != query->since;
    }
    pthread_mutex_unlock(&tiles->lock);
    return newer;
}

result_t tiles_get_nothing(tiles_t *tiles, uint64_t job, const tile_query_t *query, uint8_t **bytes,
                           size_t *size)
{
    job_settings_t settings;
    if (!settings_of(tiles, job, &settings))
        return result_fail(RESULT_UNREACHABLE, "there is no job %llu", (unsigned long long)job);
    TRY(pyramid_answer(NULL, settings.width, settings.height, query->since, query, bytes, size));
    pthread_mutex_lock(&tiles->lock);
    tiles->unsent += *size;
    pthread_mutex_unlock(&tiles->lock);
    return result_ok();
}

void tiles_note_wait(tiles_t *tiles)
{
    pthread_mutex_lock(&tiles->lock);
    tiles->waited = clock_now();
    pthread_mutex_unlock(&tiles->lock);
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
    tiles->waited = -TILES_BUSY_INTERVAL;
    tiles->max_bytes = options->max_bytes;
    tiles->max_answers = options->max_answers > 0 ? options->max_answers : TILES_MAX_ANSWERS;
    uint64_t share = memory_limit() / 16;
    if (tiles->max_bytes == 0) tiles->max_bytes = share < TILES_MAX_BYTES ? share : TILES_MAX_BYTES;
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
