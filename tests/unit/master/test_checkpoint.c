/* Checkpoints: what is written comes back bit for bit; whatever happens to the file is noticed; a disk that
 * refuses leaves the older one as it was. And the store that keeps them. */
#include "master/store/checkpoint.h"
#include "master/store/checkpoint_format.h"
#include "master/store/film_store.h"
#include "master/threads/stored_film.h"
#include "tests/films.h"
#include "tests/scratch.h"
#include "tests/toy_farm.h"

#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

static void must(result_t result)
{
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
}

/* ---- a film ------------------------------------------------------------------------------------------- */

static uint64_t draw(uint64_t *state)
{
    *state ^= *state << 13;
    *state ^= *state >> 7;
    return *state ^= *state << 17;
}

/* All first bytes of the words, then all second ones, and so on, and what is no whole word as it is. */
static void bytes_are_split_by_their_place_in_words(void **state)
{
    enum { MOST = 8 * 40 + 7 };
    (void)state;
    uint64_t random = 1;
    for (size_t size = 0; size <= MOST; size++) {
        uint8_t in[MOST] = {0}, split[MOST], back[MOST];
        size_t words = size / 8;
        for (size_t i = 0; i < size; i++) in[i] = (uint8_t)(draw(&random) >> 32);
        bytes_split(in, size, split);
        for (size_t i = 0; i < size; i++)
            assert_int_equal(in[i], split[i < 8 * words ? i % 8 * words + i / 8 : i]);
        bytes_join(split, size, back);
        if (size > 0) assert_memory_equal(back, in, size);
    }
}

/* Sums like those of a render: the upper bytes much alike, the lower noise, some zeroes. */
static void fill(int64_t *values, size_t count, uint64_t seed)
{
    uint64_t state = 88172645463325252u + seed;
    for (size_t i = 0; i < count; i++) {
        uint64_t word = draw(&state);
        values[i] = word % 5 == 0 ? 0 : (int64_t)(word >> 30) - (1 << 20);
    }
}

static job_settings_t settings_of(int width, int height)
{
    job_settings_t settings = job_settings_default();
    settings.width = width;
    settings.height = height;
    settings.spp = 16;
    settings.learn = false; /* lessons are larger than most of these films */
    return settings;
}

/* A film of which some samples are counted, and what its checkpoint says. */
typedef struct {
    shared_film_t *shared_film;
    schedule_t *schedule;
    checkpoint_info_t info;
} job_film_t;

static job_film_t make_film(const job_settings_t *settings, uint64_t seed)
{
    film_t *film;
    job_film_t made = {.schedule = schedule_new(settings)};
    must(film_new(settings, &film));
    size_t values = sum_image_values(settings, SUM_SPLAT);
    fill(film->sums[SUM_EYE], values, seed);
    fill(film->sums[SUM_SPLAT], values, seed + 1);
    if (film->sums[SUM_FEATURES] != NULL)
        fill(film->sums[SUM_FEATURES], values / 6 * FEATURE_VALUES, seed + 2);
    for (sum_kind_t k = SUM_GROUP_EYE; k <= SUM_GROUP_SPLAT; k++)
        if (film->sums[k] != NULL) fill(film->sums[k], sum_image_values(settings, k), seed + k);
    if (film->sums[SUM_LESSONS] != NULL)
        fill(film->sums[SUM_LESSONS], sum_image_values(settings, SUM_LESSONS), seed + SUM_LESSONS);
    for (size_t i = 0; i < values / 3; i++) film->samples[i] = (uint32_t)(seed + i / 64);
    film->counts = (film_counts_t){{seed, 2}, 3, 0, 5, 6};
    uint32_t tiles = job_tile_count(settings);
    if (job_learns(settings)) { /* as if so many passes had been counted */
        for (film->settled = 0; film->settled < 4; film->settled++) {
            schedule_teach(made.schedule);
            schedule_open_pass(made.schedule);
        }
    }
    for (uint32_t t = 0; t < tiles; t += 2) {
        unit_t unit = {t, 4 + t % 3, 1 + (uint32_t)seed % 2};
        must(schedule_accept(made.schedule, &unit, 1));
    }
    made.shared_film = shared_film_new(film);
    job_record_t *record = &made.info.record;
    *record = (job_record_t){
        .job = 7,
        .terms = {.name = "a scene", .priority = -3, .verify = 0.01, .mixed = true, .halves = true},
        .settings = *settings,
        .blob = hash_bytes("blob", 4),
        .blob_size = 4711,
        .state = JOB_RUNNING,
        .retained = true,
        .fingerprint = hash_bytes("bits", 4),
        .elapsed = 12.5,
        .submitted = 1.7e9,
        .bytes = 1,
        .batches = 2,
        .batches_refused = 3,
        .units_reissued = 4,
        .checks_passed = 5,
        .checks_failed = 6,
        .workers_seen = 7,
        .samples_done = 8,
        .account = {.issued = 20, .counted = 10, .returned = 6, .skipped = 1},
        .counts = {{1, 2}, 3, 4, 5, 6},
        .error = 0.25,
        .message = "all is well"};
    made.info.generation = 3;
    made.info.written = 1.7e9 + 1;
    return made;
}

static void free_film(job_film_t *film)
{
    shared_film_destroy(&film->shared_film);
    schedule_destroy(&film->schedule);
}

/* Writes the film with a state that need not be its own. */
static result_t write_state(job_film_t *film, const char *path, int threads, const schedule_state_t *state)
{
    checkpoint_cost_t cost;
    shared_film_lock(film->shared_film);
    shared_film_snapshot_t *snapshot = shared_film_snapshot(film->shared_film);
    shared_film_unlock(film->shared_film);
    result_t result = checkpoint_write(path, &film->info, state, snapshot, threads, &cost);
    shared_film_snapshot_free(&snapshot);
    if (result.code == RESULT_OK) assert_true(cost.bytes > 0 && cost.wall > 0 && cost.cpu > 0);
    return result;
}

static result_t write_film(job_film_t *film, const char *path, int threads)
{
    schedule_state_t state;
    schedule_save(film->schedule, &state);
    result_t result = write_state(film, path, threads, &state);
    schedule_state_free(&state);
    return result;
}

static void assert_same_film(const film_t *a, const film_t *b)
{
    assert_true(same_film(a, b));
    assert_int_equal(a->settled, b->settled);
    assert_memory_equal(&a->counts, &b->counts, sizeof a->counts);
}

static void assert_same_state(const schedule_state_t *a, const schedule_state_t *b)
{
    size_t cells = (size_t)a->round_count * a->tile_count;
    assert_int_equal(a->round_count, b->round_count);
    assert_int_equal(a->tile_count, b->tile_count);
    assert_int_equal(a->counted_count, b->counted_count);
    assert_int_equal(a->skipped_count, b->skipped_count);
    assert_true(a->issued == b->issued && a->returned == b->returned);
    assert_int_equal(a->settled, b->settled);
    assert_memory_equal(a->ends, b->ends, cells * sizeof *a->ends);
    assert_memory_equal(a->weights, b->weights, cells * sizeof *a->weights);
    assert_memory_equal(a->counted, b->counted, a->counted_count * sizeof *a->counted);
    assert_memory_equal(a->skipped, b->skipped, a->skipped_count * sizeof *a->skipped);
}

/* Opens and loads; the caller frees film and state. */
static result_t read_film(const char *path, const job_settings_t *settings, film_t **film,
                          schedule_state_t *state)
{
    checkpoint_t *checkpoint;
    *film = NULL;
    TRY(checkpoint_open(path, &checkpoint));
    result_t result = checkpoint_load(checkpoint, settings, 3, film, state);
    checkpoint_close(&checkpoint);
    return result;
}

/* ---- round trips --------------------------------------------------------------------------------------- */

static void assert_round_trip(const job_settings_t *settings, const char *path, int threads)
{
    job_film_t film = make_film(settings, 5);
    film_t *loaded;
    schedule_state_t expected, state;
    must(write_film(&film, path, threads));
    must(read_film(path, settings, &loaded, &state));
    schedule_save(film.schedule, &expected);
    assert_same_film(shared_film_lock(film.shared_film), loaded);
    shared_film_unlock(film.shared_film);
    assert_same_state(&expected, &state);
    schedule_state_free(&expected);
    schedule_state_free(&state);
    film_destroy(&loaded);
    free_film(&film);
}

static void what_is_written_comes_back(void **state)
{
    (void)state;
    char *folder = scratch_new(), *path = scratch_path(folder, "film");
    static const int sizes[][2] = {{1, 1}, {33, 17}, {300, 200}, {501, 263}};
    for (size_t i = 0; i < ARRAY_LENGTH(sizes); i++) {
        job_settings_t settings = settings_of(sizes[i][0], sizes[i][1]);
        settings.learn = i == 2;
        assert_round_trip(&settings, path, 1);
        settings.features = false;
        assert_round_trip(&settings, path, 4);
        strcpy(settings.light_groups, "a=area,b=0+1,rest");
        assert_round_trip(&settings, path, 2);
        settings.features = true;
        settings.integrator = INTEGRATOR_PATH;
        assert_round_trip(&settings, path, 3);
    }
    assert_int_equal(scratch_count(folder), 1); /* no temporaries */
    free(path);
    scratch_destroy(&folder);
}

static uint32_t *noise(size_t words, uint64_t seed)
{
    uint32_t *made = mem_alloc(words * sizeof *made);
    for (size_t i = 0; i < words; i++) made[i] = (uint32_t)draw(&seed);
    return made;
}

/* One sample each, every second one of every tile from the first given. */
static unit_t *scattered_units(size_t count, uint32_t tiles, uint32_t first)
{
    unit_t *made = mem_alloc(count * sizeof *made);
    for (size_t i = 0; i < count; i++)
        made[i] = (unit_t){(uint32_t)(i % tiles), first + 2 * (uint32_t)(i / tiles), 1};
    return made;
}

/* Each of the four arrays lies across the end of a page. */
static void a_long_schedule_comes_back(void **state)
{
    (void)state;
    char *folder = scratch_new(), *path = scratch_path(folder, "film");
    job_settings_t settings = settings_of(501, 263);
    settings.learn = true;
    settings.spp = 1 << 12;
    job_film_t film = make_film(&settings, 5);
    uint32_t tiles = job_tile_count(&settings),
             rounds = 5 * SHARED_FILM_PAGE_BYTES / 4 / sizeof(uint32_t) / tiles;
    size_t units = SHARED_FILM_PAGE_BYTES / sizeof(unit_t);
    schedule_state_t saved = {.round_count = rounds,
                              .settled = 4,
                              .tile_count = tiles,
                              .ends = noise((size_t)rounds * tiles, 1),
                              .weights = noise((size_t)rounds * tiles, 2),
                              .counted = scattered_units(units, tiles, 0),
                              .skipped = scattered_units(units, tiles, 1),
                              .counted_count = units,
                              .skipped_count = units,
                              .issued = 5,
                              .returned = 6};
    for (int threads = 1; threads <= 3; threads++) {
        film_t *loaded;
        schedule_state_t found;
        must(write_state(&film, path, threads, &saved));
        must(read_film(path, &settings, &loaded, &found));
        assert_same_state(&saved, &found);
        assert_same_film(shared_film_lock(film.shared_film), loaded);
        shared_film_unlock(film.shared_film);
        schedule_state_free(&found);
        film_destroy(&loaded);
    }
    schedule_state_free(&saved);
    free_film(&film);
    free(path);
    scratch_destroy(&folder);
}

/* Plans are made of lessons that are settled: a job has no more than it notes. */
static void lessons_that_cannot_be_are_not_settled(void **state)
{
    (void)state;
    char *folder = scratch_new(), *path = scratch_path(folder, "film");
    for (int learns = 0; learns < 2; learns++) {
        job_settings_t settings = settings_of(40, 40);
        settings.learn = learns;
        job_film_t film = make_film(&settings, 1);
        schedule_state_t saved, found;
        film_t *loaded = NULL;
        schedule_save(film.schedule, &saved);
        saved.settled = learns ? learning_taught(&settings) + 1 : 1;
        must(write_state(&film, path, 1, &saved));
        assert_int_equal(read_film(path, &settings, &loaded, &found).code, RESULT_INPUT);
        schedule_state_free(&saved);
        free_film(&film);
    }
    free(path);
    scratch_destroy(&folder);
}

static void it_knows_all_of_its_job(void **state)
{
    (void)state;
    char *folder = scratch_new(), *path = scratch_path(folder, "film");
    job_settings_t settings = settings_of(40, 40);
    job_film_t film = make_film(&settings, 1);
    must(write_film(&film, path, 1));
    checkpoint_t *checkpoint;
    must(checkpoint_open(path, &checkpoint));
    const checkpoint_info_t *info = checkpoint_info(checkpoint);
    const job_record_t *a = &film.info.record, *b = &info->record;
    assert_true(info->generation == 3 && info->written == film.info.written);
    assert_true(info->samples == schedule_done(film.schedule));
    assert_memory_equal(&a->settings, &b->settings, sizeof a->settings);
    assert_memory_equal(&a->terms, &b->terms, sizeof a->terms);
    assert_memory_equal(&a->account, &b->account, sizeof a->account);
    assert_memory_equal(&a->counts, &b->counts, sizeof a->counts);
    assert_true(hash_equal(&a->blob, &b->blob) && hash_equal(&a->fingerprint, &b->fingerprint));
    assert_true(b->job == 7 && b->blob_size == 4711 && b->state == JOB_RUNNING && b->retained);
    assert_true(b->elapsed == 12.5 && b->submitted == 1.7e9 && b->finished == 0 && b->error == 0.25);
    assert_true(b->bytes == 1 && b->batches == 2 && b->batches_refused == 3 && b->units_reissued == 4);
    assert_true(b->checks_passed == 5 && b->checks_failed == 6 && b->workers_seen == 7 &&
                b->samples_done == 8);
    assert_string_equal(b->message, "all is well");
    checkpoint_close(&checkpoint);
    free_film(&film);
    free(path);
    scratch_destroy(&folder);
}

/* The film of an extended job is the film of the job; that of another is not. */
static void it_belongs_to_its_picture(void **state)
{
    (void)state;
    char *folder = scratch_new(), *path = scratch_path(folder, "film");
    job_settings_t settings = settings_of(40, 40), more = settings, other = settings;
    job_film_t film = make_film(&settings, 1);
    film_t *loaded;
    schedule_state_t saved;
    must(write_film(&film, path, 1));
    more.spp = 64;
    more.time_limit = 100;
    must(read_film(path, &more, &loaded, &saved));
    schedule_state_free(&saved);
    film_destroy(&loaded);
    other.seed++;
    assert_int_equal(read_film(path, &other, &loaded, &saved).code, RESULT_INPUT);
    assert_null(loaded);
    free_film(&film);
    free(path);
    scratch_destroy(&folder);
}

/* Nor is the film of the same picture with other sums beside. */
static void it_belongs_to_its_sums(void **state)
{
    (void)state;
    char *folder = scratch_new(), *path = scratch_path(folder, "film");
    job_settings_t settings[4];
    for (size_t i = 0; i < ARRAY_LENGTH(settings); i++) settings[i] = settings_of(40, 40);
    settings[1].cryptomatte = true;
    strcpy(settings[2].light_groups, "key=0,rest");
    strcpy(settings[3].light_groups, "key=1,rest");
    for (size_t a = 0; a < ARRAY_LENGTH(settings); a++) {
        job_film_t film = make_film(&settings[a], 1);
        must(write_film(&film, path, 1));
        for (size_t b = 0; b < ARRAY_LENGTH(settings); b++) {
            film_t *loaded;
            schedule_state_t saved;
            result_t result = read_film(path, &settings[b], &loaded, &saved);
            if (result.code != (a == b ? RESULT_OK : RESULT_INPUT))
                fail_msg("the film of %zu, read for %zu: %d %s", a, b, result.code, result.message);
            film_destroy(&loaded);
            if (a == b) schedule_state_free(&saved);
        }
        free_film(&film);
    }
    free(path);
    scratch_destroy(&folder);
}

/* What a job that is over is asked for comes from the film of its image, and not from an earlier one. */
static void only_the_last_film_stands_for_the_image(void **state)
{
    (void)state;
    char *folder = scratch_new();
    job_settings_t settings = settings_of(40, 40);
    job_film_t film = make_film(&settings, 1);
    job_record_t record = film.info.record;
    film_store_t *store;
    must(film_store_open(folder, &store));
    char *path = film_store_path(store, record.job, 1);
    must(write_film(&film, path, 1));
    film_store_add(store, &(film_file_t){record.job, 1, 4096, 0}, 1);
    farm_t *farm = toy_farm(true);
    record.samples_done = schedule_done(film.schedule);
    for (int missing = 0; missing < 2; missing++, record.samples_done++) {
        film_image_t image = {0};
        result_t result = stored_film_resolve(farm, store, &record, &(film_extras_t){.halves = true}, &image);
        assert_int_equal(result.code, missing ? RESULT_INPUT : RESULT_OK);
        if (missing) assert_non_null(strstr(result.message, "submit it again"));
        assert_true((image.half[0] == NULL) == missing);
        film_image_free(&image);
    }
    farm_destroy(&farm);
    film_store_close(&store);
    free_film(&film);
    free(path);
    scratch_destroy(&folder);
}

/* ---- damage -------------------------------------------------------------------------------------------- */

static void assert_refused(const char *path, const uint8_t *bytes, size_t size,
                           const job_settings_t *settings)
{
    film_t *film;
    schedule_state_t state;
    scratch_write(path, bytes, size);
    result_t result = read_film(path, settings, &film, &state);
    if (result.code != RESULT_INPUT && result.code != RESULT_MISMATCH)
        fail_msg("accepted, or a wrong code: %d %s", result.code, result.message);
    assert_non_null(strstr(result.message, path));
    assert_null(film);
}

static void every_changed_byte_is_noticed(void **state)
{
    (void)state;
    char *folder = scratch_new(), *path = scratch_path(folder, "film");
    job_settings_t settings = settings_of(24, 20);
    job_film_t film = make_film(&settings, 1);
    must(write_film(&film, path, 1));
    size_t size;
    uint8_t *bytes = scratch_read(path, &size);
    for (size_t i = 0; i < size; i += i < 1200 ? 1 : 61) {
        bytes[i] ^= (uint8_t)(1 << (i % 8));
        assert_refused(path, bytes, size, &settings);
        bytes[i] ^= (uint8_t)(1 << (i % 8));
    }
    film_t *loaded;
    schedule_state_t saved;
    scratch_write(path, bytes, size);
    must(read_film(path, &settings, &loaded, &saved));
    schedule_state_free(&saved);
    film_destroy(&loaded);
    free(bytes);
    free_film(&film);
    free(path);
    scratch_destroy(&folder);
}

static void every_lost_end_is_noticed(void **state)
{
    (void)state;
    char *folder = scratch_new(), *path = scratch_path(folder, "film");
    job_settings_t settings = settings_of(24, 20);
    job_film_t film = make_film(&settings, 1);
    must(write_film(&film, path, 1));
    size_t size;
    uint8_t *bytes = scratch_read(path, &size);
    for (size_t i = 0; i < size; i += i < 1200 ? 7 : 97) assert_refused(path, bytes, i, &settings);
    uint8_t *longer = mem_zalloc(size + 100, 1);
    memcpy(longer, bytes, size);
    assert_refused(path, longer, size + 100, &settings);
    /* Lost sectors: a block of zeroes, as a file system may leave after a power cut. */
    for (size_t at = 0; at + 512 <= size; at += 4096) {
        memcpy(longer, bytes, size);
        memset(longer + at, 0, 512);
        if (memcmp(longer, bytes, size) != 0) assert_refused(path, longer, size, &settings);
    }
    free(longer);
    free(bytes);
    free_film(&film);
    free(path);
    scratch_destroy(&folder);
}

/* Two generations of the same film have pages of the same size at nearly the same place. */
static void a_page_of_another_generation_is_noticed(void **state)
{
    (void)state;
    char *folder = scratch_new(), *path = scratch_path(folder, "film");
    job_settings_t settings = settings_of(64, 64);
    job_film_t film = make_film(&settings, 1), next = make_film(&settings, 2);
    size_t size, next_size;
    must(write_film(&film, path, 1));
    uint8_t *bytes = scratch_read(path, &size);
    must(write_film(&next, path, 1));
    uint8_t *mixed = scratch_read(path, &next_size);
    size_t half = (size < next_size ? size : next_size) / 2;
    memcpy(mixed + half, bytes + half, 4096);
    assert_refused(path, mixed, next_size, &settings);
    free(bytes);
    free(mixed);
    free_film(&film);
    free_film(&next);
    free(path);
    scratch_destroy(&folder);
}

/* A file from a later Lightmill is not taken for a damaged one. */
static void a_later_version_is_told_from_damage(void **state)
{
    (void)state;
    char *folder = scratch_new(), *path = scratch_path(folder, "film");
    job_settings_t settings = settings_of(24, 20);
    job_film_t film = make_film(&settings, 1);
    must(write_film(&film, path, 1));
    size_t size;
    uint8_t *bytes = scratch_read(path, &size);
    bytes[8] = 3;
    scratch_write(path, bytes, size);
    checkpoint_t *checkpoint;
    result_t result = checkpoint_open(path, &checkpoint);
    assert_int_equal(result.code, RESULT_MISMATCH);
    assert_non_null(strstr(result.message, "version 3"));
    assert_null(checkpoint);
    free(bytes);
    free_film(&film);
    free(path);
    scratch_destroy(&folder);
}

/* ---- disks that refuse --------------------------------------------------------------------------------- */

/* A limit on the size of files stands for a full disk: writes fail in the middle. */
static void a_write_that_fails_leaves_the_old_file(void **state)
{
    (void)state;
    char *folder = scratch_new(), *path = scratch_path(folder, "film");
    job_settings_t settings = settings_of(200, 200);
    settings.learn = true;
    job_film_t old = make_film(&settings, 1), new = make_film(&settings, 2);
    must(write_film(&old, path, 1));
    struct rlimit before, small;
    getrlimit(RLIMIT_FSIZE, &before);
    small = (struct rlimit){300000, before.rlim_max};
    signal(SIGXFSZ, SIG_IGN);
    setrlimit(RLIMIT_FSIZE, &small);
    result_t result = write_film(&new, path, 4);
    setrlimit(RLIMIT_FSIZE, &before);
    assert_int_equal(result.code, RESULT_IO);
    assert_non_null(strstr(result.message, path));
    assert_int_equal(scratch_count(folder), 1);
    film_t *loaded;
    schedule_state_t saved;
    must(read_film(path, &settings, &loaded, &saved));
    assert_same_film(shared_film_lock(old.shared_film), loaded);
    shared_film_unlock(old.shared_film);
    schedule_state_free(&saved);
    film_destroy(&loaded);
    must(write_film(&new, path, 2)); /* and it goes on afterwards */
    free_film(&old);
    free_film(&new);
    free(path);
    scratch_destroy(&folder);
}

/* ---- the store ----------------------------------------------------------------------------------------- */

static void put_file(const char *folder, const char *name)
{
    char *path = scratch_path(folder, name);
    scratch_write(path, "film", 4);
    free(path);
}

static bool has_file(const char *folder, const char *name)
{
    char *path = scratch_path(folder, name);
    bool found = access(path, F_OK) == 0;
    free(path);
    return found;
}

static void the_store_finds_its_files(void **state)
{
    (void)state;
    char *folder = scratch_new();
    static const char *const names[] = {
        "job-3.1.film",  "job-3.10.film", "job-3.9.film", "job-12.4.film",        "job-3.11.film.77-0.part",
        "job-03.1.film", "job-4.film",    "job-4.0.film", "job-5.1.film.damaged", "notes.txt"};
    for (size_t i = 0; i < ARRAY_LENGTH(names); i++) put_file(folder, names[i]);
    film_store_t *store;
    must(film_store_open(folder, &store));
    size_t count;
    film_file_t *files = film_store_list(store, 0, &count);
    assert_int_equal(count, 4);
    assert_true(files[0].job == 3 && files[0].generation == 10 && files[0].bytes == 4);
    assert_true(files[1].generation == 9 && files[2].generation == 1 && files[3].job == 12);
    free(files);
    files = film_store_list(store, 3, &count);
    assert_int_equal(count, 3);
    free(files);
    assert_null(film_store_list(store, 4, &count));
    assert_true(film_store_bytes(store, 3) == 12 && film_store_bytes(store, 5) == 0);
    assert_false(has_file(folder, "job-3.11.film.77-0.part")); /* never finished */
    assert_true(has_file(folder, "notes.txt"));
    film_store_close(&store);
    scratch_destroy(&folder);
}

static void the_store_keeps_the_latest(void **state)
{
    (void)state;
    char *folder = scratch_new();
    film_store_t *store;
    must(film_store_open(folder, &store));
    put_file(folder, "job-3.1.film");
    film_store_add(store, &(film_file_t){3, 1, 4, 0}, 2);
    put_file(folder, "job-3.2.film");
    film_store_add(store, &(film_file_t){3, 2, 4, 0}, 2);
    assert_true(has_file(folder, "job-3.1.film"));
    put_file(folder, "job-3.3.film");
    film_store_add(store, &(film_file_t){3, 3, 4, 0}, 2);
    assert_false(has_file(folder, "job-3.1.film"));
    film_store_set_aside(store, 3, 3);
    assert_true(has_file(folder, "job-3.3.film.damaged"));
    assert_true(film_store_next(store, 3) == 4); /* a number that was never used */
    put_file(folder, "job-3.4.film");
    film_store_add(store, &(film_file_t){3, 4, 4, 0}, 1);
    assert_false(has_file(folder, "job-3.2.film"));
    put_file(folder, "job-30.1.film");
    film_store_add(store, &(film_file_t){30, 1, 4, 0}, 1);
    assert_true(film_store_delete(store, 3) == 4);
    assert_int_equal(scratch_count(folder), 1);
    assert_true(has_file(folder, "job-30.1.film"));
    film_store_close(&store);
    scratch_destroy(&folder);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(bytes_are_split_by_their_place_in_words),
        cmocka_unit_test(what_is_written_comes_back),
        cmocka_unit_test(a_long_schedule_comes_back),
        cmocka_unit_test(lessons_that_cannot_be_are_not_settled),
        cmocka_unit_test(it_knows_all_of_its_job),
        cmocka_unit_test(it_belongs_to_its_picture),
        cmocka_unit_test(it_belongs_to_its_sums),
        cmocka_unit_test(only_the_last_film_stands_for_the_image),
        cmocka_unit_test(every_changed_byte_is_noticed),
        cmocka_unit_test(every_lost_end_is_noticed),
        cmocka_unit_test(a_page_of_another_generation_is_noticed),
        cmocka_unit_test(a_later_version_is_told_from_damage),
        cmocka_unit_test(a_write_that_fails_leaves_the_old_file),
        cmocka_unit_test(the_store_finds_its_files),
        cmocka_unit_test(the_store_keeps_the_latest),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
