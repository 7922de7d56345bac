/* Tests of the worker as its master sees it: a real worker, with render threads and sockets, and a master
 * that withholds grants, forgets, breaks connections and comes back, as the test says (tests/scripted.h). */
#include "proto/uplink/bulk.h"
#include "tests/films.h"
#include "tests/render_here.h"
#include "tests/scratch.h"
#include "tests/scripted.h"
#include "worker/worker.h"

#include <pthread.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { JOB = 3 };
static const double PATIENCE = 30; /* seconds for anything */

typedef struct {
    char *folder;
    test_scene_t scene;
    scripted_t *script;
    char *endpoint, *cache;
    worker_options_t options;
    atomic_int stop;
    pthread_t thread;
    result_t outcome;
    bool running;
} fixture_t;

static void *worker_thread(void *argument)
{
    fixture_t *t = argument;
    t->outcome = worker_run(&t->options, &t->stop);
    return NULL;
}

static void start_worker(fixture_t *t)
{
    assert_int_equal(pthread_create(&t->thread, NULL, worker_thread, t), 0);
    t->running = true;
}

static result_t join_worker(fixture_t *t)
{
    pthread_join(t->thread, NULL);
    t->running = false;
    return t->outcome;
}

static int set_up(void **state)
{
    fixture_t *t = mem_zalloc(1, sizeof *t);
    log_init("test", LOG_ERROR);
    t->folder = scratch_new();
    t->cache = scratch_path(t->folder, "cache");
    t->scene = test_scene_begin((vec3_t){0, 0, -0.9f}, 60, 64);
    blob_material_t diffuse = {.kind = MATERIAL_DIFFUSE};
    diffuse.values[VALUE_REFLECTANCE] = blob_constant(0.5f);
    uint32_t grey = test_scene_material(&t->scene, diffuse);
    test_scene_room(&t->scene, (vec3_t){-1, -1, -1}, (vec3_t){1, 1, 1}, grey, (rgb_t){0.2f, 0.2f, 0.2f});
    test_scene_finish(&t->scene);
    job_settings_t settings = blob_default_settings(&t->scene.blob);
    settings.learn = false; /* its units are of any samples */
    settings.spp = 1 << 20;
    settings.tile_size = 32;
    settings.max_depth = 3;
    t->script = scripted_new(&t->scene.blob, &settings);
    t->endpoint = scripted_endpoint(t->script);
    t->options = worker_options_default();
    t->options.control_endpoint = t->endpoint;
    t->options.cache_dir = t->cache;
    t->options.threads = 1;
    t->options.name = "test";
    t->options.grace = PATIENCE;
    *state = t;
    return 0;
}

static int tear_down(void **state)
{
    fixture_t *t = *state;
    atomic_store(&t->stop, 2);
    if (t->running) join_worker(t);
    scripted_destroy(&t->script);
    test_scene_end(&t->scene);
    scratch_destroy(&t->folder);
    free(t->endpoint);
    free(t->cache);
    free(t);
    return 0;
}

/* What these units make, bit for bit, is what came. */
static void assert_renders(fixture_t *t, const scripted_batch_t *came)
{
    renderer_t *renderer;
    unit_result_t result = {0};
    atomic_bool cancel = false;
    batch_t again;
    batch_init(&again, &t->script->settings);
    assert_int_equal(renderer_new(&t->scene.blob, &t->script->settings, &renderer).code, RESULT_OK);
    for (size_t i = 0; i < came->batch.unit_count; i++) {
        assert_true(renderer_unit(renderer, &came->batch.units[i], &result, &cancel));
        batch_add(&again, &result);
    }
    assert_true(same_sums(&again, &came->batch));
    batch_free(&again);
    unit_result_free(&result);
    renderer_destroy(&renderer);
}

/* ---- tests --------------------------------------------------------------------------------------------- */

static void a_hello_says_what_the_machine_is(void **state)
{
    fixture_t *t = *state;
    scripted_t *s = t->script;
    start_worker(t);
    scripted_run(s, s->hellos > 0 && s->heartbeats > 0, PATIENCE);
    assert_int_equal(s->hello->fingerprint.len, HASH_BYTES);
    assert_int_equal(s->hello->threads, 1);
    assert_string_equal(s->hello->name, "test");
    assert_false(s->hello->relay);
    assert_int_equal(s->heartbeat_threads, 1);
}

/* It holds out until the socket answers, and says what is wrong meanwhile. */
static void a_silent_bulk_socket_is_told_and_tried_on(void **state)
{
    fixture_t *t = *state;
    scripted_t *s = t->script;
    const unit_t unit = {0, 0, 4};
    char text[100];
    t->options.patience = BULK_SILENT_SECONDS + 1;
    s->deaf = true;
    scripted_assign(s, JOB, 0, &unit, 1);
    double start = clock_now();
    start_worker(t);
    scripted_run(s, s->trouble[0] != '\0', PATIENCE);
    assert_true(clock_now() - start < 2 * BULK_SILENT_SECONDS);
    snprintf(text, sizeof text, "port %d of 127.0.0.1 does not answer: open it", s->bulk_port);
    assert_non_null(strstr(s->trouble, text));
    assert_int_equal(s->work_requests, 0);
    s->deaf = false;
    scripted_run(s, s->batch_count == 1 && s->trouble[0] == '\0', PATIENCE);
    assert_true(s->probes >= 3 && s->hellos == 1);
}

static void a_batch_is_offered_before_it_is_closed(void **state)
{
    fixture_t *t = *state;
    scripted_t *s = t->script;
    const unit_t first[] = {{0, 0, 4}, {1, 0, 4}}, more[] = {{2, 0, 4}};
    t->options.patience = 0.3;
    s->granting = false;
    scripted_assign(s, JOB, 0, first, 2);
    start_worker(t);
    scripted_run(s, s->offers > 0, PATIENCE);
    assert_int_equal(s->offer.job, JOB);
    hash_t content = job_content_hash(&s->settings, &t->scene.blob.hash);
    assert_true(hash_equal(&s->offer.content, &content));
    /* While the offer waits the batch grows. */
    scripted_assign(s, JOB, 0, more, 1);
    scripted_run(s, s->unit_count == 0, PATIENCE);
    uint64_t bytes = s->offered_bytes;
    scripted_run(s, s->same_offers > 3, PATIENCE);
    assert_true(s->offered_bytes > bytes);
    assert_int_equal(s->batch_count, 0);
    scripted_grant(s);
    scripted_run(s, s->batch_count == 1, PATIENCE);
    assert_int_equal(s->batches[0].batch.unit_count, 3);
    assert_true(s->batches[0].worker == s->worker && s->batches[0].job == JOB);
    assert_true(hash_equal(&s->batches[0].content, &content));
    assert_renders(t, &s->batches[0]);
}

/* From the moment the master is there again, with a new process, everything goes on within two seconds. */
static void finished_work_outlives_the_master(void **state)
{
    fixture_t *t = *state;
    scripted_t *s = t->script;
    const unit_t units[] = {{0, 0, 4}, {1, 0, 4}}, again[] = {{0, 0, 8}, {3, 0, 4}};
    s->granting = false;
    scripted_assign(s, JOB, 0, units, 2);
    start_worker(t);
    scripted_run(s, s->offers > 0, PATIENCE);
    scripted_sleep(s, 0.3);
    uint64_t earlier = s->worker;
    scripted_restart(s, 1.5);
    /* The new process knows nothing of what was out and gives it out again. */
    scripted_assign(s, JOB, 0, again, 2);
    double start = clock_now();
    scripted_run(s, s->unit_count == 0, PATIENCE);
    double first_assignment = clock_now() - start;
    print_message("%.3f s from the master's return to the first assignment\n", first_assignment);
    assert_true(first_assignment < 2);
    assert_int_equal(s->kept_count, 2); /* it said what it has */
    hash_t content = job_content_hash(&s->settings, &t->scene.blob.hash);
    assert_true(hash_equal(&s->kept_content, &content));
    scripted_grant_when_taken(s, PATIENCE);
    scripted_run(s, scripted_samples(s, 3) == 4 && scripted_samples(s, 0) == 8, PATIENCE);
    assert_true(s->worker != earlier);
    for (int i = 0; i < s->batch_count; i++) {
        assert_int_equal(s->batches[i].worker, s->worker);
        assert_renders(t, &s->batches[i]);
    }
    assert_int_equal(scripted_samples(s, 0), 8); /* nothing twice */
    assert_int_equal(scripted_samples(s, 1), 4);
    assert_int_equal(s->hellos, 2);
}

/* It was silent for too long, and its number means nothing any more. */
static void a_forgotten_worker_says_hello_and_keeps_its_batch(void **state)
{
    fixture_t *t = *state;
    scripted_t *s = t->script;
    const unit_t unit = {2, 0, 4};
    s->granting = false;
    scripted_assign(s, JOB, 0, &unit, 1);
    start_worker(t);
    scripted_run(s, s->offers > 0, PATIENCE);
    scripted_forget(s);
    s->granting = true;
    scripted_run(s, s->batch_count == 1, PATIENCE);
    assert_int_equal(s->hellos, 2);
    assert_int_equal(s->batches[0].worker, s->worker);
    assert_int_equal(scripted_samples(s, 2), 4);
}

/* The verdict came late, while it found out whether its new number is good for anything. */
static void a_verdict_counts_while_a_forgotten_worker_introduces_itself(void **state)
{
    fixture_t *t = *state;
    scripted_t *s = t->script;
    s->answering = false;
    scripted_assign(s, JOB, 0, &(unit_t){2, 0, 4}, 1);
    start_worker(t);
    scripted_run(s, s->batch_count == 1, PATIENCE);
    s->deaf = true;
    int probes = s->probes, offers = s->offers;
    scripted_forget(s);
    scripted_run(s, s->hellos == 2 && s->probes > probes, PATIENCE);
    scripted_verdict(s, true);
    s->answering = true;
    scripted_sleep(s, 0.2); /* a probe is waited for for a second */
    s->deaf = false;
    scripted_assign(s, JOB, 0, &(unit_t){1, 0, 4}, 1);
    scripted_run(s, s->batch_count == 2, PATIENCE);
    assert_int_equal(scripted_samples(s, 2), 4); /* nothing twice */
    assert_int_equal(scripted_samples(s, 1), 4);
    assert_int_equal(s->offers, offers + 1);
}

static void a_broken_connection_is_noticed_at_once(void **state)
{
    fixture_t *t = *state;
    scripted_t *s = t->script;
    const unit_t unit = {2, 0, 4};
    s->answering = false;
    scripted_assign(s, JOB, 0, &unit, 1);
    start_worker(t);
    scripted_run(s, s->batch_count == 1, PATIENCE);
    int offers = s->offers;
    scripted_break_bulk(s); /* the batch may be lost, for all the worker knows */
    s->answering = true;
    double start = clock_now();
    scripted_run(s, s->batch_count == 2, PATIENCE);
    assert_true(clock_now() - start < 10); /* patience is 20 s */
    assert_true(s->offers > offers);       /* it asked first */
    assert_int_equal(s->batches[0].sequence, s->batches[1].sequence);
    assert_int_equal(s->batches[1].batch.unit_count, 1);
    assert_int_equal(s->hellos, 1);
}

/* Nothing is sent twice over a connection that is merely slow: the worker asks. */
static void a_silent_master_is_asked_before_anything_is_sent_again(void **state)
{
    fixture_t *t = *state;
    scripted_t *s = t->script;
    const unit_t unit = {2, 0, 4};
    t->options.patience = 0.5;
    s->answering = false;
    scripted_assign(s, JOB, 0, &unit, 1);
    start_worker(t);
    scripted_run(s, s->batch_count == 1, PATIENCE);
    s->granting = false;
    int offers = s->offers;
    scripted_run(s, s->offers > offers + 1, PATIENCE);
    assert_int_equal(s->batch_count, 1);
    /* The answer to the question proves that the batch is there: its verdict is waited for. */
    scripted_question_t question = s->question;
    scripted_grant(s);
    scripted_sleep(s, 0.2);
    assert_int_equal(s->batch_count, 1);
    s->question = question;
    scripted_verdict(s, true);
    scripted_sleep(s, 1);
    assert_int_equal(s->batch_count, 1);
    /* And if it does not come at all, the batch does go again. */
    s->granting = true;
    scripted_assign(s, JOB, 0, &(unit_t){2, 4, 4}, 1);
    scripted_run(s, s->batch_count == 3, PATIENCE);
    assert_int_equal(s->batches[1].sequence, s->batches[2].sequence);
}

static void a_refused_offer_ends_the_batch(void **state)
{
    fixture_t *t = *state;
    scripted_t *s = t->script;
    const unit_t unit = {2, 0, 4}, other = {1, 0, 4};
    s->refusal = result_fail(RESULT_CANCELLED, "the job is over");
    scripted_assign(s, JOB, 0, &unit, 1);
    start_worker(t);
    scripted_run(s, s->offers > 0, PATIENCE);
    scripted_sleep(s, 0.5);
    assert_int_equal(s->offers, 1);
    assert_int_equal(s->batch_count, 0);
    s->refusal = result_ok();
    scripted_assign(s, JOB + 1, 0, &other, 1);
    scripted_run(s, s->batch_count == 1, PATIENCE);
    assert_int_equal(s->batches[0].job, JOB + 1);
    assert_int_equal(s->batches[0].batch.unit_count, 1);
}

static void a_master_without_room_is_asked_again(void **state)
{
    fixture_t *t = *state;
    scripted_t *s = t->script;
    const unit_t unit = {2, 0, 4};
    s->refusal = result_fail(RESULT_LIMIT, "no room");
    scripted_assign(s, JOB, 0, &unit, 1);
    start_worker(t);
    scripted_run(s, s->offers > 2, PATIENCE);
    s->refusal = result_ok();
    scripted_run(s, s->batch_count == 1, PATIENCE);
    assert_int_equal(scripted_samples(s, 2), 4);
}

static void a_refused_batch_is_thrown_away(void **state)
{
    fixture_t *t = *state;
    scripted_t *s = t->script;
    const unit_t unit = {2, 0, 4};
    s->counting = false;
    scripted_assign(s, JOB, 0, &unit, 1);
    start_worker(t);
    scripted_run(s, s->batch_count == 1, PATIENCE);
    s->counting = true;
    scripted_assign(s, JOB, 0, &unit, 1); /* it may be given the same again */
    scripted_run(s, s->batch_count == 2, PATIENCE);
    assert_true(s->batches[1].sequence > s->batches[0].sequence);
    assert_renders(t, &s->batches[1]);
}

static void checked_units_come_alone(void **state)
{
    fixture_t *t = *state;
    scripted_t *s = t->script;
    const unit_t ordinary[] = {{0, 0, 4}, {1, 0, 4}}, checked[] = {{3, 0, 4}, {2, 0, 4}};
    s->batch_interval = 1000;
    scripted_assign(s, JOB, 0, ordinary, 2);
    start_worker(t);
    scripted_run(s, s->unit_count == 0, PATIENCE);
    scripted_assign(s, JOB, 77, checked, 2);
    scripted_run(s, s->batch_count > 0 && s->batches[s->batch_count - 1].check == 77, PATIENCE);
    const scripted_batch_t *came = &s->batches[s->batch_count - 1];
    assert_int_equal(came->batch.unit_count, 2);
    assert_memory_equal(came->batch.units, checked, sizeof checked);
    assert_renders(t, came);
    scripted_run(s, scripted_samples(s, 0) == 4 && scripted_samples(s, 1) == 4, PATIENCE);
}

/* The master lost its data, and job 3 is another one now. */
static void another_job_of_the_same_number_gets_nothing_of_the_old(void **state)
{
    fixture_t *t = *state;
    scripted_t *s = t->script;
    const unit_t old = {0, 0, 4}, new = {1, 0, 4};
    s->granting = false;
    scripted_assign(s, JOB, 0, &old, 1);
    start_worker(t);
    scripted_run(s, s->offers > 0, PATIENCE);
    hash_t old_content = s->offer.content;
    scripted_restart(s, 0.3);
    s->settings.seed += 5;
    scripted_assign(s, JOB, 0, &new, 1);
    scripted_run(s, s->unit_count == 0, PATIENCE);
    s->granting = true;
    scripted_run(s, s->batch_count > 0 && scripted_samples(s, 1) == 4, PATIENCE);
    for (int i = 0; i < s->batch_count; i++) {
        /* An old batch says so itself; a master would refuse it. */
        if (hash_equal(&s->batches[i].content, &old_content)) continue;
        assert_int_equal(s->batches[i].batch.unit_count, 1);
        assert_int_equal(s->batches[i].batch.units[0].tile, 1);
        assert_renders(t, &s->batches[i]);
    }
}

static void a_paused_job_is_sent_and_goes_on(void **state)
{
    fixture_t *t = *state;
    scripted_t *s = t->script;
    const unit_t unit = {0, 0, 4}, more = {1, 0, 4};
    s->batch_interval = 1000;
    scripted_assign(s, JOB, 0, &unit, 1);
    start_worker(t);
    scripted_run(s, s->unit_count == 0, PATIENCE);
    scripted_sleep(s, 0.5);
    scripted_job_over(s, JOB, true);
    scripted_run(s, s->batch_count == 1, PATIENCE);
    assert_int_equal(s->batches[0].batch.unit_count, 1);
    scripted_assign(s, JOB, 0, &more, 1);
    scripted_run(s, s->batch_count == 2, PATIENCE);
    assert_renders(t, &s->batches[1]);
}

static void a_drained_worker_delivers_and_says_goodbye(void **state)
{
    fixture_t *t = *state;
    scripted_t *s = t->script;
    unit_t units[16];
    for (uint32_t i = 0; i < 16; i++) units[i] = (unit_t){i % 4, 64 * (i / 4), 64};
    s->batch_interval = 1000;
    scripted_assign(s, JOB, 0, units, 16);
    start_worker(t);
    scripted_run(s, s->unit_count == 0, PATIENCE);
    scripted_sleep(s, 0.1);
    atomic_store(&t->stop, 1);
    scripted_run(s, s->goodbyes == 1, PATIENCE);
    assert_int_equal(join_worker(t).code, RESULT_OK);
    assert_true(s->batch_count <= 1);
}

static void a_worker_that_cannot_deliver_says_so(void **state)
{
    fixture_t *t = *state;
    scripted_t *s = t->script;
    const unit_t unit = {0, 0, 4};
    t->options.grace = 0.5;
    s->granting = false;
    scripted_assign(s, JOB, 0, &unit, 1);
    start_worker(t);
    scripted_run(s, s->offers > 0, PATIENCE);
    double start = clock_now();
    atomic_store(&t->stop, 1);
    scripted_run(s, s->goodbyes == 1, PATIENCE);
    result_t result = join_worker(t);
    assert_int_equal(result.code, RESULT_UNREACHABLE);
    assert_non_null(strstr(result.message, "0.5 s"));
    assert_true(clock_now() - start < 10);
}

int main(void)
{
#define WITH_FIXTURE(test) cmocka_unit_test_setup_teardown(test, set_up, tear_down)
    const struct CMUnitTest tests[] = {
        WITH_FIXTURE(a_hello_says_what_the_machine_is),
        WITH_FIXTURE(a_silent_bulk_socket_is_told_and_tried_on),
        WITH_FIXTURE(a_batch_is_offered_before_it_is_closed),
        WITH_FIXTURE(finished_work_outlives_the_master),
        WITH_FIXTURE(a_forgotten_worker_says_hello_and_keeps_its_batch),
        WITH_FIXTURE(a_verdict_counts_while_a_forgotten_worker_introduces_itself),
        WITH_FIXTURE(a_broken_connection_is_noticed_at_once),
        WITH_FIXTURE(a_silent_master_is_asked_before_anything_is_sent_again),
        WITH_FIXTURE(a_refused_offer_ends_the_batch),
        WITH_FIXTURE(a_master_without_room_is_asked_again),
        WITH_FIXTURE(a_refused_batch_is_thrown_away),
        WITH_FIXTURE(checked_units_come_alone),
        WITH_FIXTURE(another_job_of_the_same_number_gets_nothing_of_the_old),
        WITH_FIXTURE(a_paused_job_is_sent_and_goes_on),
        WITH_FIXTURE(a_drained_worker_delivers_and_says_goodbye),
        WITH_FIXTURE(a_worker_that_cannot_deliver_says_so),
    };
    return cmocka_run_group_tests_name("worker", tests, NULL, NULL);
}
