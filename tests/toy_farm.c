/* toy_farm: see toy_farm.h. */
#include "tests/toy_farm.h"
#include "tests/films.h"

#include "master/state/state.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

static const identity_t nobody = {{0}, 0};

enum { FILMS = 1 << 20, ROOMY = 64 << 20 }; /* bytes; a job that learns needs more */

static farm_t *make_farm(bool keeps, bool tells, const char *spool_dir, uint64_t quota, uint64_t films)
{
    farm_options_t options = {.lease = 5,
                              .batch_interval = 10,
                              .film_limit = films,
                              .first_job = 1,
                              .spool_dir = spool_dir,
                              .evidence_limit = quota,
                              .control_wake = -1,
                              .image_wake = -1,
                              .journal_writer_wake = -1,
                              .news_wake = tells ? 1 << 30 : -1,
                              .checkpoint_wake = keeps ? 1 << 30 : -1, /* nobody listens */
                              .grant_wake = -1};
    log_init("test", LOG_ERROR);
    return farm_new(&options);
}

farm_t *toy_farm(bool keeps)
{
    return make_farm(keeps, false, NULL, 0, FILMS);
}

farm_t *toy_roomy_farm(void)
{
    return make_farm(false, false, NULL, 0, ROOMY);
}

farm_t *toy_verifying_farm(const char *spool_dir)
{
    return toy_quota_farm(spool_dir, (uint64_t)1 << 30);
}

farm_t *toy_quota_farm(const char *spool_dir, uint64_t quota)
{
    return make_farm(true, false, spool_dir, quota, ROOMY);
}

farm_t *toy_telling_farm(void)
{
    return make_farm(true, true, NULL, 0, FILMS);
}

farm_t *toy_brisk_farm(double batch_interval)
{
    farm_t *farm = toy_farm(false);
    farm->options.batch_interval = batch_interval;
    return farm;
}

job_settings_t toy_settings(void)
{
    job_settings_t settings = job_settings_default();
    settings.width = settings.height = 32;
    settings.tile_size = 16;
    settings.features = settings.learn = false;
    settings.spp = 4;
    return settings;
}

uint64_t toy_submit(farm_t *farm, double now, const job_settings_t *settings, int priority)
{
    return toy_submit_on(farm, now, settings, &(job_terms_t){.name = "toy", .priority = priority});
}

uint64_t toy_submit_on(farm_t *farm, double now, const job_settings_t *settings, const job_terms_t *terms)
{
    hash_t blob = {{0}};
    uint64_t job;
    assert_int_equal(farm_submit(farm, now, terms, settings, &blob, 1, &job).code, RESULT_OK);
    return job;
}

uint64_t toy_hello(farm_t *farm, double now, uint32_t threads)
{
    return toy_join(farm, now, "w", threads, 0);
}

result_t toy_say_hello(farm_t *farm, double now, worker_hello_t hello, uint64_t *worker)
{
    char host[WIRE_MAX_ADDRESS + 1];
    snprintf(host, sizeof host, "%.*s", (int)strcspn(hello.name, ":"), hello.name);
    hello.address = host;
    if (hello.key == NULL) hello.key = "";
    result_t result = farm_hello(farm, now, &nobody, &hello, worker);
    return result.code == RESULT_OK ? farm_worker_reached(farm, now, *worker) : result;
}

uint64_t toy_join(farm_t *farm, double now, const char *name, uint32_t threads, uint8_t fingerprint)
{
    worker_hello_t hello = {.name = name, .threads = threads, .fingerprint = {{fingerprint}}};
    uint64_t worker;
    assert_int_equal(toy_say_hello(farm, now, hello, &worker).code, RESULT_OK);
    return worker;
}

bool toy_beat(farm_t *farm, double now, uint64_t worker)
{
    return farm_heartbeat(farm, now, &nobody, worker, 0, 1);
}

toy_work_t toy_take(farm_t *farm, double now, uint64_t worker, uint64_t samples, uint64_t unit_samples)
{
    unit_t units[WIRE_MAX_UNITS] = {0};
    issue_t issues[WIRE_MAX_UNITS] = {0};
    work_t work = {.units = units, .issues = issues};
    toy_work_t taken = {0};
    assert_int_equal(farm_take(farm, now, &nobody, worker, 0, samples, unit_samples, &work).code, RESULT_OK);
    taken.job = work.job;
    if (work.job == 0) return taken;
    assert_true(work.unit_count <= ARRAY_LENGTH(taken.units));
    taken.count = work.unit_count;
    taken.check = work.check;
    memcpy(taken.units, units, work.unit_count * sizeof *units);
    memcpy(taken.issues, issues, work.unit_count * sizeof *issues);
    return taken;
}

/* Something between 0.5 and 1.5, always the same. */
static int64_t noise(uint64_t sample, uint64_t tile, uint64_t value)
{
    uint64_t x = sample * 0x9E3779B97F4A7C15u + tile * 0xD1B54A32D192ED03u + value * 0x8CB92BA72F3D8DD7u;
    x = (x ^ (x >> 32)) * 0xD6E8FEB86659FD93u;
    x = (x ^ (x >> 32)) * 0xD6E8FEB86659FD93u;
    return ((int64_t)1 << 31) + (int64_t)(x >> 32);
}

/* Every sample adds a value of its own to every pixel of its tile; tile 0 is the darkest. */
static void fill_tile(int64_t *eye, size_t values, const unit_t *unit)
{
    for (uint32_t s = unit->first; s < unit->first + unit->count; s++)
        for (size_t i = 0; i < values / 2; i++)
            eye[(s % 2) * (values / 2) + i] += noise(s, unit->tile, i) * (1 + (int64_t)unit->tile);
}

/* As many as its units trace. */
static void count_light_paths(batch_t *batch)
{
    for (int half = 0; half < 2; half++) {
        batch->counts.light_paths[half] = 0;
        for (size_t i = 0; i < batch->unit_count && job_has_splats(&batch->settings); i++)
            batch->counts.light_paths[half] += (uint64_t)unit_half_count(&batch->units[i], half) *
                                               job_tile_pixels(&batch->settings, batch->units[i].tile);
    }
}

static batch_t make_batch(const job_settings_t *settings, const unit_t *units, size_t count)
{
    batch_t batch;
    batch_init(&batch, settings);
    batch.units = mem_alloc(count * sizeof *units);
    memcpy(batch.units, units, count * sizeof *units);
    batch.unit_count = batch.unit_capacity = count;
    sum_array_zeroes(&batch.sums[SUM_EYE], batch_expected_values(&batch, SUM_EYE));
    int64_t *tile = batch.sums[SUM_EYE].values;
    for (size_t i = 0; i < count; i++) {
        size_t values = sum_unit_values(settings, SUM_EYE, &units[i]);
        fill_tile(tile, values, &units[i]);
        tile += values;
    }
    sum_array_t *groups = &batch.sums[SUM_GROUP_EYE];
    sum_array_reserve(groups, batch_expected_values(&batch, SUM_GROUP_EYE));
    groups->count = batch_expected_values(&batch, SUM_GROUP_EYE);
    for (size_t i = 0; i < groups->count; i++)
        groups->values[i] = (int64_t)(i % 1000) << settings->film_scale;
    count_light_paths(&batch);
    return batch;
}

void toy_issue(farm_t *farm, uint64_t worker, uint64_t job, uint64_t check, const unit_t *units, size_t count,
               issue_t *issues)
{
    farm_lock(farm);
    const worker_t *to = farm_find_worker(farm, worker);
    const job_t *of = farm_find_job(farm, job);
    unit_mac_t mac = {{0}};
    if (to != NULL && of != NULL) mac = farm_unit_mac(farm, to, of, check);
    farm_unlock(farm);
    unit_mac_issue(&mac, units, count, issues);
}

static result_t deliver(farm_t *farm, double now, uint64_t worker, uint64_t id, uint64_t check,
                        const unit_t *units, const issue_t *issues, size_t count, int64_t lie, bool one_wrong,
                        uint64_t overflows)
{
    farm_batch_t open;
    batch_head_t head = {.worker = worker,
                         .job = id,
                         .check = check,
                         .units = units,
                         .issues = issues,
                         .unit_count = count,
                         .bytes = 1000};
    TRY(farm_batch_begin(farm, now, &head, &open));
    batch_t batch = make_batch(&open.settings, units, count);
    size_t wrong =
        one_wrong ? sum_unit_values(&open.settings, SUM_EYE, &units[0]) : batch.sums[SUM_EYE].count;
    for (size_t i = 0; i < wrong; i++) batch.sums[SUM_EYE].values[i] += lie;
    batch.counts.overflows = overflows;
    zmq_msg_t payload[BATCH_PAYLOADS];
    assert_int_equal(encode_either(&batch, false, payload).code, RESULT_OK);
    result_t result = farm_batch_commit(farm, now, &open, &batch, payload);
    for (int i = 0; i < BATCH_PAYLOADS; i++) zmq_msg_close(&payload[i]);
    batch_free(&batch);
    return result;
}

/* As if the units had been issued to the worker. */
static result_t deliver_issued(farm_t *farm, double now, uint64_t worker, uint64_t job, uint64_t check,
                               const unit_t *units, size_t count, int64_t lie, bool one_wrong)
{
    issue_t *issues = mem_alloc((count + 1) * sizeof *issues);
    toy_issue(farm, worker, job, check, units, count, issues);
    result_t result = deliver(farm, now, worker, job, check, units, issues, count, lie, one_wrong, 0);
    free(issues);
    return result;
}

result_t toy_deliver(farm_t *farm, double now, uint64_t worker, uint64_t job, const unit_t *units,
                     size_t count)
{
    return deliver_issued(farm, now, worker, job, 0, units, count, 0, false);
}

result_t toy_deliver_work(farm_t *farm, double now, uint64_t worker, const toy_work_t *work, int64_t lie)
{
    return deliver_issued(farm, now, worker, work->job, work->check, work->units, work->count, lie,
                          work->one_wrong);
}

result_t toy_deliver_as(farm_t *farm, double now, uint64_t worker, const toy_work_t *work)
{
    return deliver(farm, now, worker, work->job, work->check, work->units, work->issues, work->count, 0,
                   false, 0);
}

result_t toy_deliver_overflow(farm_t *farm, double now, uint64_t worker, const toy_work_t *work)
{
    return deliver(farm, now, worker, work->job, work->check, work->units, work->issues, work->count, 0,
                   false, 1);
}

void toy_work_off(farm_t *farm, double now, uint64_t worker, uint64_t job)
{
    for (toy_work_t work; (work = toy_take(farm, now, worker, 1024, 512)).job != 0;) {
        assert_int_equal(work.job, job);
        assert_int_equal(toy_deliver(farm, now, worker, job, work.units, work.count).code, RESULT_OK);
    }
}

job_report_t toy_report(farm_t *farm, double now, uint64_t job)
{
    size_t count;
    uint32_t workers;
    job_report_t *reports = farm_report(farm, now, job, &count, &workers), one;
    if (count != 1) fail_msg("there is no job %llu", (unsigned long long)job);
    one = reports[0];
    free(reports);
    return one;
}

job_state_t toy_state(farm_t *farm, double now, uint64_t job)
{
    return toy_report(farm, now, job).record.state;
}

result_t toy_order(farm_t *farm, double now, uint64_t job, order_kind_t kind)
{
    return farm_order(farm, now, &(job_order_t){.job = job, .kind = kind});
}

int toy_write_images(farm_t *farm, double now, result_t result)
{
    int count = 0;
    for (job_t *job; (job = farm_next_finished(farm)) != NULL; count++) {
        farm_finished(farm, now, job, result, NULL);
        farm_unpin(farm, job);
    }
    return count;
}

bool toy_checkpoint(farm_t *farm, double now, result_t result, toy_film_t *film)
{
    double age;
    bool last;
    shared_film_snapshot_t *snapshot;
    job_t *job = farm_next_checkpoint(farm, now, &age, &last);
    if (job == NULL) return false;
    *film = (toy_film_t){.job = farm_job_id(job)};
    job_settings_t settings = farm_job_settings(farm, job);
    assert_int_equal(film_new(&settings, &film->film).code, RESULT_OK);
    assert_true(farm_snapshot(farm, job, &film->state, &snapshot));
    for (size_t i = 0; i < shared_film_page_count(&settings); i++) {
        size_t size;
        void *page = shared_film_page(film->film, i, &size);
        uint8_t *bytes = mem_alloc(SHARED_FILM_PAGE_BYTES);
        assert_int_equal(shared_film_snapshot_read(snapshot, i, bytes), size);
        memcpy(page, bytes, size);
        free(bytes);
    }
    film->film->counts = shared_film_snapshot_counts(snapshot);
    shared_film_snapshot_free(&snapshot);
    farm_checkpointed(farm, now, job, result);
    farm_unpin(farm, job);
    if (result.code != RESULT_OK) toy_film_free(film);
    return true;
}

bool toy_load(farm_t *farm, double now, toy_film_t *film)
{
    job_t *job = farm_next_load(farm);
    if (job == NULL) return false;
    if (film != NULL) assert_int_equal(farm_job_id(job), film->job);
    result_t result = farm_loaded(farm, now, job, film ? film->film : NULL, film ? &film->state : NULL);
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
    if (film != NULL) *film = (toy_film_t){0};
    farm_unpin(farm, job);
    return true;
}

void toy_film_free(toy_film_t *film)
{
    if (film->job == 0) return;
    film_destroy(&film->film);
    schedule_state_free(&film->state);
    *film = (toy_film_t){0};
}

hash_t toy_sums(farm_t *farm, uint64_t id)
{
    job_t *job = farm_pin(farm, id);
    film_image_t image = {0};
    job_report_t report;
    assert_non_null(job);
    assert_int_equal(farm_resolve(farm, 0, job, NULL, &image, &report).code, RESULT_OK);
    size_t bytes = 3 * sizeof(float) * (size_t)image.width * (size_t)image.height;
    hash_t parts[2] = {hash_bytes(image.sum, bytes), hash_bytes(image.noise, bytes)};
    film_image_free(&image);
    farm_unpin(farm, job);
    return hash_bytes(parts, sizeof parts);
}
