/* Tests of the render pool: what becomes of units from their assignment to the batch that has them, whatever
 * the master says meanwhile. The calls are those of the control and the bulk thread; render threads, scene
 * and renderer are real. */
#include "proto/wire/wire.h"
#include "tests/films.h"
#include "tests/render_here.h"
#include "worker/checks.h"
#include "worker/render_pool.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/resource.h>
#include <time.h>
#include <unistd.h>

#include <cmocka.h>

enum { JOB = 7 };
static const double PATIENCE = 20;         /* seconds */
static const double NEVER = 1000;          /* a batch interval that does not end here, */
static const double AT_ONCE = 0;           /* and one that is over */
static const uint64_t MEMORY = 1ull << 34; /* bytes: plenty */
static const uint64_t SCARCE = 1ull << 20; /* not even two units of tiles */

typedef struct {
    test_scene_t scene;
    job_settings_t settings;
    render_pool_t *fixture;
    uplink_handler_t handler;
    int wakes[2];
} bench_t;

static void sleep_briefly(void)
{
    nanosleep(&(struct timespec){.tv_nsec = 2000000}, NULL);
}

static void open_pool(bench_t *b, int threads, uint64_t memory)
{
    render_pool_destroy(&b->fixture);
    render_pool_options_t options = {
        .threads = threads, .memory = memory, .control_wake = b->wakes[0], .bulk_wake = b->wakes[1]};
    b->fixture = render_pool_new(&options);
    b->handler = render_pool_handler(b->fixture);
}

static int set_up(void **state)
{
    bench_t *b = mem_zalloc(1, sizeof *b);
    log_init("test", LOG_ERROR);
    b->scene = test_scene_begin((vec3_t){0, 0, -0.9f}, 60, 64);
    blob_material_t diffuse = {.kind = MATERIAL_DIFFUSE};
    diffuse.values[VALUE_REFLECTANCE] = blob_constant(0.5f);
    uint32_t grey = test_scene_material(&b->scene, diffuse);
    test_scene_room(&b->scene, (vec3_t){-1, -1, -1}, (vec3_t){1, 1, 1}, grey, (rgb_t){0.2f, 0.2f, 0.2f});
    test_scene_finish(&b->scene);
    b->settings = blob_default_settings(&b->scene.blob);
    b->settings.learn = false;
    b->settings.spp = 1024;
    b->settings.tile_size = 32;
    b->settings.max_depth = 3;
    for (int i = 0; i < 2; i++) b->wakes[i] = eventfd(0, EFD_NONBLOCK);
    open_pool(b, 2, MEMORY);
    *state = b;
    return 0;
}

static int tear_down(void **state)
{
    bench_t *b = *state;
    render_pool_destroy(&b->fixture);
    assert_null(b->fixture);
    test_scene_end(&b->scene);
    for (int i = 0; i < 2; i++) close(b->wakes[i]);
    free(b);
    return 0;
}

/* ---- what the two threads do --------------------------------------------------------------------------- */

/* What the master sends with a unit here. */
static uint64_t mac_of(const unit_t *unit, uint64_t check)
{
    return ((uint64_t)unit->tile << 40 ^ (uint64_t)unit->first << 20 ^ unit->count ^ check << 60) + 1;
}

/* Units come back with the MACs of those that they lie in. */
static void check_issues(const unit_t *units, const issue_t *issues, size_t count, uint64_t check)
{
    for (size_t i = 0; i < count; i++) {
        unit_t issued = {units[i].tile, units[i].first - issues[i].before,
                         issues[i].before + units[i].count + issues[i].after};
        assert_true(issues[i].mac == mac_of(&issued, check));
    }
}

static void assign_by_plans(bench_t *b, uint64_t job, uint64_t check, const unit_t *units, size_t count,
                            const hash_t plans[LEARNING_PASSES])
{
    assignment_t assignment = {.job = job,
                               .check = check,
                               .settings = b->settings,
                               .blob = b->scene.blob.hash,
                               .blob_size = b->scene.blob.size,
                               .content = job_content_hash(&b->settings, &b->scene.blob.hash),
                               .unit_count = count};
    /* In one piece of memory, which begins with the units. */
    uint64_t *memory = mem_alloc((3 * count + 1) * sizeof *memory);
    assignment.units = memcpy(memory, units, count * sizeof *units);
    assignment.macs = memory + 2 * count;
    for (size_t i = 0; i < count; i++) assignment.macs[i] = mac_of(&units[i], check);
    memcpy(assignment.plans, plans, sizeof assignment.plans);
    b->handler.calls->assign(b->handler.self, &assignment);
}

static void assign_check(bench_t *b, uint64_t job, uint64_t check, const unit_t *units, size_t count)
{
    assign_by_plans(b, job, check, units, count, (hash_t[LEARNING_PASSES]){{{0}}});
}

static void assign(bench_t *b, const unit_t *units, size_t count)
{
    assign_check(b, JOB, 0, units, count);
}

static uplink_state_t state_of(bench_t *b)
{
    return b->handler.calls->state(b->handler.self);
}

static duty_t duty_of(bench_t *b, double batch_interval)
{
    return b->handler.calls->duty(b->handler.self, batch_interval, 0);
}

/* Asks for duties until one of this kind comes; no other may. */
static duty_t await_duty(bench_t *b, duty_kind_t kind, double batch_interval)
{
    for (double start = clock_now();; sleep_briefly()) {
        duty_t duty = duty_of(b, batch_interval);
        if (duty.kind == kind) return duty;
        assert_int_equal(duty.kind, DUTY_NONE);
        if (clock_now() - start > PATIENCE) fail_msg("there is no duty of kind %d", (int)kind);
    }
}

static void load(bench_t *b, uint64_t job)
{
    duty_t duty = await_duty(b, DUTY_LOAD, NEVER);
    assert_int_equal(duty.assignment.job, job);
    scene_blob_t blob = b->scene.blob;
    assert_int_equal(b->handler.calls->loaded(b->handler.self, job, &blob).code, RESULT_OK);
}

/* Waits until so many units are in ordinary batches, and no thread has any. */
static void await_rendered(bench_t *b, size_t units)
{
    unit_t kept[64];
    issue_t issues[64];
    for (double start = clock_now();; sleep_briefly()) {
        size_t count = b->handler.calls->kept(b->handler.self, JOB, kept, issues, ARRAY_LENGTH(kept));
        if (count == units && state_of(b).rendering == 0) return;
        if (clock_now() - start > PATIENCE) fail_msg("%zu units, not %zu, are rendered", count, units);
    }
}

static void await_idle_threads(bench_t *b)
{
    for (double start = clock_now(); state_of(b).rendering > 0; sleep_briefly())
        if (clock_now() - start > PATIENCE) fail_msg("rendering goes on");
}

static closed_batch_t close_offer(bench_t *b, const duty_t *duty)
{
    assert_int_equal(duty->kind, DUTY_OFFER);
    assert_true(duty->offer.bytes > 0);
    closed_batch_t closed = b->handler.calls->close(b->handler.self, &duty->offer);
    if (closed.batch != NULL)
        check_issues(closed.batch->units, closed.issues, closed.batch->unit_count, duty->offer.check);
    return closed;
}

static void sent(bench_t *b, const closed_batch_t *closed)
{
    b->handler.calls->sent(b->handler.self, closed, true);
    free(closed->issues);
}

/* Samples of a tile in a batch; fails when two units share one. */
static uint32_t samples_of(const batch_t *batch, uint32_t tile)
{
    uint32_t samples = 0;
    for (size_t i = 0; i < batch->unit_count; i++) {
        const unit_t *u = &batch->units[i];
        if (u->tile == tile) samples += u->count;
        for (size_t j = 0; j < i; j++) {
            const unit_t *v = &batch->units[j];
            assert_false(u->tile == v->tile && u->first < v->first + v->count &&
                         v->first < u->first + u->count);
        }
    }
    return samples;
}

/* The batch is, bit for bit, what these units make. */
static void assert_renders(bench_t *b, const batch_t *batch)
{
    renderer_t *renderer;
    unit_result_t result = {0};
    atomic_bool cancel = false;
    batch_t again;
    batch_init(&again, &b->settings);
    assert_int_equal(renderer_new(&b->scene.blob, &b->settings, &renderer).code, RESULT_OK);
    for (size_t i = 0; i < batch->unit_count; i++) {
        assert_true(renderer_unit(renderer, &batch->units[i], &result, &cancel));
        batch_add(&again, &result);
    }
    assert_true(same_sums(&again, batch));
    batch_free(&again);
    unit_result_free(&result);
    renderer_destroy(&renderer);
}

/* ---- tests --------------------------------------------------------------------------------------------- */

static void units_become_a_batch(void **state)
{
    bench_t *b = *state;
    const unit_t units[] = {{0, 0, 4}, {1, 0, 4}, {2, 7, 3}};
    assert_true(state_of(b).idle && state_of(b).samples > 0 && state_of(b).ready);
    assign(b, units, 3);
    load(b, JOB);
    assert_int_equal(state_of(b).job, JOB);
    await_rendered(b, 3);
    assert_int_equal(duty_of(b, NEVER).kind, DUTY_NONE);
    duty_t duty = await_duty(b, DUTY_OFFER, AT_ONCE);
    assert_int_equal(duty.offer.job, JOB);
    assert_int_equal(duty.offer.check, 0);
    closed_batch_t closed = close_offer(b, &duty);
    assert_int_equal(closed.batch->unit_count, 3);
    assert_renders(b, closed.batch);
    assert_int_equal(state_of(b).units_held, 3);
    sent(b, &closed);
    assert_true(state_of(b).idle);
    assert_int_equal(duty_of(b, AT_ONCE).kind, DUTY_NONE);
}

static void an_offered_batch_grows_until_it_is_closed(void **state)
{
    bench_t *b = *state;
    const unit_t first = {0, 0, 2}, second = {1, 0, 2}, third = {2, 0, 2};
    assign(b, &first, 1);
    load(b, JOB);
    duty_t duty = await_duty(b, DUTY_OFFER, AT_ONCE);
    assign(b, &second, 1);
    await_rendered(b, 2);
    closed_batch_t closed = close_offer(b, &duty);
    assert_int_equal(closed.batch->unit_count, 2);
    /* What is rendered while it is under way is for the next one. */
    assign(b, &third, 1);
    await_rendered(b, 3);
    assert_int_equal(closed.batch->unit_count, 2);
    uint64_t sequence = closed.sequence;
    sent(b, &closed);
    duty = await_duty(b, DUTY_OFFER, AT_ONCE);
    closed = close_offer(b, &duty);
    assert_int_equal(closed.batch->unit_count, 1);
    assert_true(closed.sequence > sequence);
    assert_renders(b, closed.batch);
    sent(b, &closed);
}

static void a_batch_waits_for_nothing_when_nothing_comes(void **state)
{
    bench_t *b = *state;
    const unit_t unit = {3, 0, 1};
    assign(b, &unit, 1);
    load(b, JOB);
    await_rendered(b, 1);
    assert_int_equal(duty_of(b, NEVER).kind, DUTY_NONE);
    b->handler.calls->no_more(b->handler.self);
    assert_int_equal(duty_of(b, NEVER).kind, DUTY_OFFER);
}

/* A master that was restarted gives out again what is in hand here. */
static void samples_in_hand_are_not_rendered_again(void **state)
{
    bench_t *b = *state;
    const unit_t before[] = {{0, 8, 8}, {1, 0, 8}, {2, 0, 4}};
    const unit_t again[] = {{0, 0, 32}, {1, 0, 8}, {1, 4, 8}, {2, 0, 2}, {3, 0, 4}, {3, 2, 4}, {3, 0, 6}};
    assign(b, before, 3);
    load(b, JOB);
    await_rendered(b, 3);
    duty_t duty = await_duty(b, DUTY_OFFER, AT_ONCE);
    closed_batch_t under_way = close_offer(b, &duty);
    const unit_t open = {1, 12, 4};
    assign(b, &open, 1);
    await_rendered(b, 4);
    for (size_t i = 0; i < ARRAY_LENGTH(again); i++) assign(b, &again[i], 1);
    b->handler.calls->no_more(b->handler.self);
    sent(b, &under_way);
    duty = await_duty(b, DUTY_OFFER, NEVER);
    closed_batch_t closed = close_offer(b, &duty);
    assert_int_equal(samples_of(closed.batch, 0), 24);
    assert_int_equal(samples_of(closed.batch, 1), 8);
    assert_int_equal(samples_of(closed.batch, 2), 0);
    assert_int_equal(samples_of(closed.batch, 3), 6);
    assert_renders(b, closed.batch);
    sent(b, &closed);
}

/* What waits for the rest of its check has no lessons and no splats of its own: those would be megabytes a
 * unit. */
static void a_check_keeps_lessons_and_splats_once(void **state)
{
    bench_t *b = *state;
    enum { UNITS = 3 };
    checks_t checks = {0};
    unit_t *units = mem_zalloc(UNITS, sizeof *units);
    job_settings_t settings = b->settings;
    batch_t plain;
    settings.learn = true;
    batch_init(&plain, &settings);
    for (uint32_t i = 0; i < UNITS; i++) units[i] = (unit_t){i, 0, 2};
    checks_push(&checks, &settings, 1, units, NULL, UNITS);
    for (size_t i = UNITS; i-- > 0;) { /* in another order */
        unit_check_t *check = checks_next(&checks);
        check->begun++;
        check->rendering++;
        for (int twice = 0; twice < 2; twice++) {
            unit_result_t result = {0};
            unit_result_reset(&result, &settings, &units[i]);
            for (size_t place = 0; place < 5; place++) unit_result_teach(&result, place, i + place);
            result.splats = mem_zalloc(1, sizeof *result.splats);
            result.splats[0] = (splat_t){.pixel = (uint32_t)i, .rgb = {1, 2, (float)i}};
            result.splat_count = result.splat_capacity = 1;
            if (twice == 0) checks_finish(&checks, check, i, &result);
            if (twice == 1) batch_add(&plain, &result);
            unit_result_free(&result);
        }
        assert_null(check->results[i].lessons);
        assert_null(check->results[i].splats);
    }
    unit_check_t *check = checks_complete(&checks);
    assert_true(checks_bytes(check, &settings) > sum_frame_bytes(&settings));
    checks_close(check);
    assert_memory_equal(batch_frame(&check->batch, SUM_SPLAT), batch_frame(&plain, SUM_SPLAT),
                        sum_image_values(&settings, SUM_SPLAT) * sizeof(int64_t));
    assert_memory_equal(batch_frame(&check->batch, SUM_LESSONS), batch_frame(&plain, SUM_LESSONS),
                        LEARNING_PLACES * sizeof(int64_t));
    check->under_way = false;
    checks_drop(&checks, true);
    batch_free(&plain);
}

static void a_check_makes_a_batch_of_its_own(void **state)
{
    bench_t *b = *state;
    const unit_t ordinary[] = {{0, 0, 8}, {1, 0, 8}}, checked[] = {{3, 4, 4}, {2, 0, 2}, {0, 0, 8}};
    assign(b, ordinary, 2);
    load(b, JOB);
    await_rendered(b, 2);
    assign_check(b, JOB, 99, checked, 3);
    assign_check(b, JOB, 100, checked + 1, 1);
    duty_t duty = await_duty(b, DUTY_OFFER, NEVER);
    assert_int_equal(duty.offer.check, 99);
    assert_int_equal(duty.offer.job, JOB);
    closed_batch_t closed = close_offer(b, &duty);
    assert_int_equal(closed.batch->unit_count, 3);
    assert_memory_equal(closed.batch->units, checked, sizeof checked);
    assert_renders(b, closed.batch);
    assert_int_equal(duty_of(b, NEVER).kind, DUTY_NONE); /* one at a time */
    sent(b, &closed);
    duty = await_duty(b, DUTY_OFFER, NEVER);
    assert_int_equal(duty.offer.check, 100);
    closed = close_offer(b, &duty);
    assert_int_equal(closed.batch->unit_count, 1);
    sent(b, &closed);
    duty = await_duty(b, DUTY_OFFER, AT_ONCE);
    assert_int_equal(duty.offer.check, 0);
    closed = close_offer(b, &duty);
    assert_int_equal(closed.batch->unit_count, 2);
    sent(b, &closed);
    assert_true(state_of(b).idle);
}

static void a_check_can_be_the_first_assignment(void **state)
{
    bench_t *b = *state;
    const unit_t unit = {1, 0, 2};
    assign_check(b, JOB, 5, &unit, 1);
    load(b, JOB);
    duty_t duty = await_duty(b, DUTY_OFFER, NEVER);
    assert_int_equal(duty.offer.check, 5);
    b->handler.calls->job_over(b->handler.self, JOB, true);
    assert_null(close_offer(b, &duty).batch); /* nobody wants it any more */
}

static void a_forgotten_worker_keeps_what_was_begun(void **state)
{
    bench_t *b = *state;
    enum { UNITS = 40 };
    unit_t units[UNITS], kept[UNITS];
    issue_t issues[UNITS];
    for (uint32_t i = 0; i < UNITS; i++) units[i] = (unit_t){i % 4, 16 * (i / 4), 16};
    assign(b, units, UNITS);
    assign_check(b, JOB, 8, units, 2);
    load(b, JOB);
    await_duty(b, DUTY_OFFER, AT_ONCE);
    size_t count = b->handler.calls->kept(b->handler.self, JOB, kept, issues, UNITS);
    assert_true(count > 0 && count < UNITS);
    check_issues(kept, issues, count, 0);
    assert_int_equal(b->handler.calls->kept(b->handler.self, JOB + 1, kept, issues, UNITS), 0);
    b->handler.calls->forget(b->handler.self);
    await_idle_threads(b);
    size_t held = state_of(b).units_held;
    assert_true(held + 2 >= count && held < UNITS); /* a unit may be seen on its way into the batch */
    duty_t duty = await_duty(b, DUTY_OFFER, NEVER); /* in a hurry */
    assert_int_equal(duty.offer.check, 0);
    closed_batch_t closed = close_offer(b, &duty);
    assert_int_equal(closed.batch->unit_count, held);
    sent(b, &closed);
    assert_true(state_of(b).idle);
    assert_true(state_of(b).samples > 0);
}

static void a_job_that_is_over_is_dropped(void **state)
{
    bench_t *b = *state;
    const unit_t units[] = {{0, 0, 4}, {1, 0, 4}};
    assign(b, units, 2);
    load(b, JOB);
    await_rendered(b, 2);
    duty_t duty = await_duty(b, DUTY_OFFER, AT_ONCE);
    assert_false(b->handler.calls->unwanted(b->handler.self, JOB));
    b->handler.calls->job_over(b->handler.self, JOB, false);
    assert_true(b->handler.calls->unwanted(b->handler.self, JOB));
    assert_null(close_offer(b, &duty).batch);
    assert_int_equal(duty_of(b, AT_ONCE).kind, DUTY_NONE);
    assert_int_equal(state_of(b).job, 0);
    assert_true(state_of(b).idle);
}

/* Paused: what is finished is sent; when it goes on the scene is still there. */
static void a_paused_job_goes_on_without_loading(void **state)
{
    bench_t *b = *state;
    const unit_t units[] = {{0, 0, 4}, {1, 0, 4}};
    assign(b, units, 2);
    load(b, JOB);
    await_rendered(b, 2);
    b->handler.calls->job_over(b->handler.self, JOB, true);
    assert_false(b->handler.calls->unwanted(b->handler.self, JOB));
    assert_int_equal(state_of(b).samples, 0);
    duty_t duty = await_duty(b, DUTY_OFFER, NEVER);
    closed_batch_t closed = close_offer(b, &duty);
    assert_int_equal(closed.batch->unit_count, 2);
    sent(b, &closed);
    assert_true(state_of(b).idle && state_of(b).samples > 0);
    const unit_t more = {2, 0, 4};
    assign(b, &more, 1);
    duty = await_duty(b, DUTY_OFFER, AT_ONCE); /* no DUTY_LOAD before */
    closed = close_offer(b, &duty);
    assert_int_equal(closed.batch->unit_count, 1);
    assert_renders(b, closed.batch);
    sent(b, &closed);
}

static void another_job_waits_for_the_last_batch(void **state)
{
    bench_t *b = *state;
    const unit_t unit = {0, 0, 4};
    assign(b, &unit, 1);
    load(b, JOB);
    await_rendered(b, 1);
    assign_check(b, JOB + 1, 0, &unit, 1);
    assert_int_equal(state_of(b).samples, 0);
    assert_int_equal(state_of(b).units_held, 2); /* one of each job */
    duty_t duty = await_duty(b, DUTY_OFFER, NEVER);
    assert_int_equal(duty.offer.job, JOB);
    closed_batch_t closed = close_offer(b, &duty);
    assert_int_equal(duty_of(b, NEVER).kind, DUTY_NONE);
    sent(b, &closed);
    load(b, JOB + 1);
    duty = await_duty(b, DUTY_OFFER, AT_ONCE);
    assert_int_equal(duty.offer.job, JOB + 1);
}

/* A master that lost its data gives the numbers of old jobs to new ones. */
static void a_number_alone_does_not_make_a_job(void **state)
{
    bench_t *b = *state;
    const unit_t unit = {0, 0, 4};
    assign(b, &unit, 1);
    load(b, JOB);
    await_rendered(b, 1);
    duty_t old = await_duty(b, DUTY_OFFER, AT_ONCE);
    b->settings.seed++;
    assign(b, &unit, 1);
    assert_null(close_offer(b, &old).batch);
    load(b, JOB);
    duty_t duty = await_duty(b, DUTY_OFFER, AT_ONCE);
    assert_false(hash_equal(&duty.offer.content, &old.offer.content));
    closed_batch_t closed = close_offer(b, &duty);
    assert_int_equal(closed.batch->unit_count, 1);
    assert_renders(b, closed.batch);
    sent(b, &closed);
}

static void draining_finishes_what_was_begun(void **state)
{
    bench_t *b = *state;
    enum { UNITS = 40 };
    unit_t units[UNITS];
    for (uint32_t i = 0; i < UNITS; i++) units[i] = (unit_t){i % 4, 16 * (i / 4), 16};
    assign(b, units, UNITS);
    load(b, JOB);
    await_duty(b, DUTY_OFFER, AT_ONCE);
    b->handler.calls->drain(b->handler.self);
    assert_int_equal(state_of(b).samples, 0);
    await_idle_threads(b);
    size_t held = state_of(b).units_held;
    assert_true(held > 0 && held < UNITS);
    duty_t duty = await_duty(b, DUTY_OFFER, NEVER);
    assign(b, units + held, 1); /* came too late */
    closed_batch_t closed = close_offer(b, &duty);
    assert_int_equal(closed.batch->unit_count, held);
    assert_false(state_of(b).idle);
    sent(b, &closed);
    assert_true(state_of(b).idle);
}

static void units_that_take_too_long_are_given_up(void **state)
{
    bench_t *b = *state;
    const unit_t quick = {0, 0, 1};
    unit_t endless[2] = {{1, 0, 1 << 16}, {2, 0, 1 << 16}};
    b->settings.spp = 1 << 20;
    assign(b, &quick, 1);
    load(b, JOB);
    await_rendered(b, 1);
    assign(b, endless, 2);
    unit_t kept[4];
    issue_t issues[4];
    while (b->handler.calls->kept(b->handler.self, JOB, kept, issues, 4) < 3) sleep_briefly();
    b->handler.calls->drain(b->handler.self);
    assert_int_equal(duty_of(b, NEVER).kind, DUTY_NONE);
    b->handler.calls->give_up(b->handler.self);
    duty_t duty = await_duty(b, DUTY_OFFER, NEVER);
    closed_batch_t closed = close_offer(b, &duty);
    assert_int_equal(closed.batch->unit_count, 1);
    sent(b, &closed);
    assert_true(state_of(b).idle);
}

static void rendering_pauses_while_the_batch_is_full(void **state)
{
    bench_t *b = *state;
    enum { UNITS = 12 };
    unit_t units[UNITS];
    for (uint32_t i = 0; i < UNITS; i++) units[i] = (unit_t){i % 4, 1 + i / 4, 1};
    open_pool(b, 1, SCARCE);
    assign(b, units, UNITS);
    load(b, JOB);
    size_t rendered = 0, batches = 0;
    while (rendered < UNITS) {
        duty_t duty = await_duty(b, DUTY_OFFER, rendered < UNITS - 1 ? NEVER : AT_ONCE); /* full: at once */
        sleep_briefly();
        closed_batch_t closed = close_offer(b, &duty);
        assert_true(closed.batch->unit_count <= 2);
        rendered += closed.batch->unit_count;
        batches++;
        sent(b, &closed);
    }
    assert_int_equal(rendered, UNITS);
    assert_true(batches >= UNITS / 2);
}

/* A master may assign as many units as fit into a message while nearly as many are held. */
static void a_batch_fits_into_a_message(void **state)
{
    bench_t *b = *state;
    enum { MORE = 512, UNITS = WIRE_MAX_UNITS + MORE, THREADS = 2 };
    unit_t *units = mem_alloc(2 * UNITS * sizeof *units), *kept = units + UNITS;
    issue_t *issues = mem_alloc(UNITS * sizeof *issues);
    for (uint32_t i = 0; i < UNITS; i++) units[i] = (unit_t){0, i, 1};
    b->settings.spp = 1 << 16;
    b->settings.width = b->settings.height = 2;
    assign(b, units, WIRE_MAX_UNITS);
    assign(b, units + WIRE_MAX_UNITS, MORE);
    load(b, JOB);
    double start = clock_now();
    while (b->handler.calls->kept(b->handler.self, JOB, kept, issues, UNITS) < WIRE_MAX_UNITS - THREADS) {
        sleep_briefly();
        if (clock_now() - start > PATIENCE) fail_msg("the batch does not fill");
    }
    for (int i = 0; i < 50; i++) sleep_briefly(); /* more is added, if it is ever */
    duty_t duty = await_duty(b, DUTY_OFFER, NEVER);
    closed_batch_t closed = close_offer(b, &duty);
    size_t first = closed.batch->unit_count;
    assert_in_range(first, WIRE_MAX_UNITS - THREADS, WIRE_MAX_UNITS);
    b->handler.calls->no_more(b->handler.self);
    sent(b, &closed);
    duty = await_duty(b, DUTY_OFFER, NEVER);
    await_idle_threads(b);
    closed = close_offer(b, &duty);
    assert_int_equal(first + closed.batch->unit_count, UNITS);
    sent(b, &closed);
    free(issues);
    free(units);
}

/* The last ones of a long queue, while threads finish the first ones and these are sent, a few at a time. */
static void units_that_wait_keep_their_macs(void **state)
{
    bench_t *b = *state;
    enum { UNITS = WIRE_MAX_UNITS, BATCHES = 1000 };
    unit_t *units = mem_alloc(UNITS * sizeof *units);
    for (uint32_t i = 0; i < UNITS; i++) units[i] = (unit_t){0, i, 1};
    b->settings.spp = UNITS;
    b->settings.width = b->settings.height = 2;
    assign(b, units, UNITS);
    load(b, JOB);
    size_t delivered = 0;
    for (int batches = 0; delivered < UNITS; batches++) {
        duty_t duty = await_duty(b, DUTY_OFFER, batches < BATCHES ? AT_ONCE : NEVER);
        closed_batch_t closed = close_offer(b, &duty);
        delivered += closed.batch->unit_count;
        sent(b, &closed);
    }
    free(units);
}

static void a_film_beyond_the_memory_is_declined(void **state)
{
    bench_t *b = *state;
    const unit_t unit = {0, 0, 1};
    open_pool(b, 1, SCARCE);
    b->settings.width = b->settings.height = 256;
    assign(b, &unit, 1);
    assert_int_equal(duty_of(b, NEVER).kind, DUTY_NONE);
    uplink_state_t s = state_of(b);
    assert_int_equal(s.failure.code, RESULT_LIMIT);
    assert_int_equal(s.failed, JOB);
    assert_int_equal(s.samples, 0);
    b->handler.calls->clear_failure(b->handler.self);
    assert_int_equal(duty_of(b, NEVER).kind, DUTY_NONE);
    assert_int_equal(state_of(b).failure.code, RESULT_OK);
    assert_true(state_of(b).idle && state_of(b).samples > 0);
}

static void a_scene_that_cannot_be_loaded_is_declined(void **state)
{
    bench_t *b = *state;
    const unit_t unit = {0, 0, 1};
    assign(b, &unit, 1);
    await_duty(b, DUTY_LOAD, NEVER);
    b->handler.calls->refuse(b->handler.self, JOB, result_fail(RESULT_INPUT, "no such scene"));
    assert_int_equal(state_of(b).failure.code, RESULT_INPUT);
    b->handler.calls->clear_failure(b->handler.self);
    assert_int_equal(duty_of(b, NEVER).kind, DUTY_NONE);
    assert_true(state_of(b).idle);
}

/* Asks for a duty on a link of so many bytes a second. */
static duty_kind_t duty_on_link(bench_t *b, double rate)
{
    return b->handler.calls->duty(b->handler.self, 10, rate).kind;
}

/* Two batches of what it delivers in a quarter of an interval are in hand, and nothing is asked for beyond.
 */
static void a_slow_link_bounds_what_is_in_hand(void **state)
{
    bench_t *b = *state;
    const double rate = 5e3;
    const unit_t unit = {0, 0, 1}, more[] = {{1, 0, 1}, {2, 0, 1}};
    b->settings.width = b->settings.height = 512;
    double fast = (double)state_of(b).samples;
    duty_on_link(b, rate);
    double first = (double)state_of(b).samples;
    assert_true(first > 0 && first < 0.2 * fast); /* of a job that nothing is known of */
    assign(b, &unit, 1);
    load(b, JOB);
    await_rendered(b, 1);
    assert_int_equal(duty_on_link(b, 0), DUTY_NONE);
    assert_int_equal(duty_on_link(b, rate), DUTY_OFFER); /* long before the interval is over */
    duty_t duty = b->handler.calls->duty(b->handler.self, 10, rate);
    closed_batch_t closed = close_offer(b, &duty);
    assign(b, more, 2);
    await_rendered(b, 3);
    assert_int_equal(state_of(b).samples, 0);
    closed.coded[SUM_EYE] = 15000;
    closed.coded[SUM_SPLAT] = 20000; /* seven seconds */
    sent(b, &closed);
    assert_int_equal(state_of(b).samples, 0);
    assert_string_equal(state_of(b).trouble, "");
    duty = await_duty(b, DUTY_OFFER, AT_ONCE);
    closed = close_offer(b, &duty);
    duty_on_link(b, rate);
    assert_int_equal(state_of(b).samples, 32 * 32); /* one unit, the smallest */
    duty_on_link(b, rate / 5);                      /* 35 seconds: not worth it */
    assert_int_equal(state_of(b).samples, 0);
    assert_non_null(
        strstr(state_of(b).trouble, "carries 1 kB/s, so the smallest batch of job 7, 35 kB, takes 35 s"));
    duty_on_link(b, 1e9);
    assert_string_equal(state_of(b).trouble, "");
    assert_true(state_of(b).samples > 32 * 32);
    sent(b, &closed);
}

/* Bytes of address space that this process has. */
static uint64_t address_space(void)
{
    unsigned long long pages = 0;
    FILE *file = fopen("/proc/self/statm", "r");
    assert_non_null(file);
    assert_int_equal(fscanf(file, "%llu", &pages), 1);
    fclose(file);
    return pages * (uint64_t)sysconf(_SC_PAGESIZE);
}

/* It says so, and lives on, instead of dying in the middle of it. */
static void a_job_that_memory_is_missing_for_is_declined(void **state)
{
    bench_t *b = *state;
    const unit_t unit = {0, 0, 1};
    struct rlimit before, small;
    job_settings_t settings = b->settings;
    getrlimit(RLIMIT_AS, &before);
    small = before;
    small.rlim_cur = address_space() + (64 << 20);
    b->settings.width = b->settings.height = 2048; /* 200 MB of frames a batch */
    setrlimit(RLIMIT_AS, &small);
    assign(b, &unit, 1);
    duty_t duty = duty_of(b, NEVER);
    setrlimit(RLIMIT_AS, &before);
    assert_int_equal(duty.kind, DUTY_NONE);
    uplink_state_t s = state_of(b);
    assert_int_equal(s.failure.code, RESULT_LIMIT);
    assert_true(s.failed == JOB && s.samples == 0);
    assert_non_null(strstr(s.failure.message, "2048 x 2048"));
    assert_non_null(strstr(s.failure.message, "cannot get"));
    /* A smaller one goes. */
    b->handler.calls->clear_failure(b->handler.self);
    b->settings = settings;
    duty_of(b, NEVER);
    assign(b, &unit, 1);
    assert_int_equal(duty_of(b, NEVER).kind, DUTY_LOAD);
}

/* ---- plans --------------------------------------------------------------------------------------------- */

enum { PLANNED = 2 }; /* the pass of units from sample 4 on */

/* The bytes of a plan of the job, in fresh memory; *hash is theirs. */
static uint8_t *plan_of(const job_settings_t *settings, const hash_t *blob, uint32_t pass, hash_t *hash)
{
    uint8_t *bytes = mem_alloc(learning_plan_bytes());
    int64_t *lessons = mem_zalloc((size_t)learning_teachers(pass) * LEARNING_PLACES, sizeof *lessons);
    hash_t content = job_content_hash(settings, blob);
    learning_plan_write(pass, lessons, &content, 0, bytes, learning_plan_bytes());
    *hash = hash_bytes(bytes, learning_plan_bytes());
    free(lessons);
    return bytes;
}

static result_t bring_plan(bench_t *b, const duty_t *duty, const uint8_t *bytes, size_t size)
{
    assert_int_equal(duty->kind, DUTY_PLAN);
    return b->handler.calls->planned(b->handler.self, &duty->assignment, duty->pass, bytes, size);
}

static void expect_no_plan(bench_t *b, const duty_t *duty, const uint8_t *bytes, size_t size, const char *why)
{
    result_t result = bring_plan(b, duty, bytes, size);
    assert_true(result.code == RESULT_INPUT || result.code == RESULT_MISMATCH);
    if (strstr(result.message, why) == NULL) fail_msg("'%s' does not say '%s'", result.message, why);
}

static void units_wait_for_their_plan(void **state)
{
    bench_t *b = *state;
    const unit_t units[] = {{0, 4, 4}, {1, 0, 2}};
    b->settings.learn = true;
    hash_t plans[LEARNING_PASSES] = {{{0}}}, hash;
    uint8_t *bytes = plan_of(&b->settings, &b->scene.blob.hash, PLANNED, &plans[PLANNED]);
    size_t size = learning_plan_bytes();
    assign_by_plans(b, JOB, 0, units, 2, plans);
    load(b, JOB);
    await_rendered(b, 1); /* the other one */
    duty_t duty = duty_of(b, NEVER);
    assert_int_equal(duty.pass, PLANNED);
    assert_true(hash_equal(&duty.assignment.plans[PLANNED], &plans[PLANNED]));
    job_settings_t other_settings = b->settings;
    other_settings.seed++;
    uint8_t *other = plan_of(&other_settings, &b->scene.blob.hash, PLANNED, &hash);
    uint8_t *third = plan_of(&b->settings, &b->scene.blob.hash, PLANNED + 1, &hash);
    expect_no_plan(b, &duty, bytes, size - 1, "pass 2 with");
    expect_no_plan(b, &duty, other, size, "another job");
    expect_no_plan(b, &duty, third, size, "pass 3");
    sleep_briefly();
    await_rendered(b, 1);
    assert_int_equal(bring_plan(b, &duty, bytes, size).code, RESULT_OK);
    await_rendered(b, 2);
    duty = await_duty(b, DUTY_OFFER, AT_ONCE);
    closed_batch_t closed = close_offer(b, &duty);
    assert_int_equal(closed.batch->unit_count, 2);
    sent(b, &closed);
    free(bytes);
    free(other);
    free(third);
}

/* A plan that does not come keeps no batch from being sent. */
static void batches_and_plans_take_turns(void **state)
{
    bench_t *b = *state;
    const unit_t units[] = {{0, 4, 4}, {1, 0, 2}};
    b->settings.learn = true;
    hash_t plans[LEARNING_PASSES] = {[PLANNED] = hash_bytes("plan", 4)};
    assign_by_plans(b, JOB, 0, units, 2, plans);
    load(b, JOB);
    await_rendered(b, 1);
    assert_int_equal(duty_of(b, AT_ONCE).kind, DUTY_PLAN);
    assert_int_equal(duty_of(b, AT_ONCE).kind, DUTY_OFFER);
    assert_int_equal(duty_of(b, AT_ONCE).kind, DUTY_PLAN);
    assert_int_equal(duty_of(b, NEVER).kind, DUTY_PLAN);
    b->handler.calls->forget(b->handler.self); /* nobody waits for it any more */
    assert_int_equal(duty_of(b, AT_ONCE).kind, DUTY_OFFER);
    assert_int_equal(duty_of(b, NEVER).kind, DUTY_OFFER);
}

/* A check may be of any pass. */
static void a_check_waits_for_its_plan(void **state)
{
    bench_t *b = *state;
    const unit_t checked[] = {{0, 0, 2}, {0, 4, 4}};
    b->settings.learn = true;
    hash_t plans[LEARNING_PASSES] = {{{0}}};
    uint8_t *bytes = plan_of(&b->settings, &b->scene.blob.hash, PLANNED, &plans[PLANNED]);
    assign_by_plans(b, JOB, 9, checked, 2, plans);
    load(b, JOB);
    duty_t duty = await_duty(b, DUTY_PLAN, AT_ONCE);
    assert_int_equal(bring_plan(b, &duty, bytes, learning_plan_bytes()).code, RESULT_OK);
    duty = await_duty(b, DUTY_OFFER, AT_ONCE);
    assert_int_equal(duty.offer.check, 9);
    closed_batch_t closed = close_offer(b, &duty);
    assert_int_equal(closed.batch->unit_count, 2);
    sent(b, &closed);
    free(bytes);
}

/* A master that lost some of a job may go by another plan: nothing of the two is mixed. */
static void another_plan_makes_another_job(void **state)
{
    bench_t *b = *state;
    const unit_t units[] = {{0, 4, 4}, {1, 4, 4}};
    b->settings.learn = true;
    hash_t plans[LEARNING_PASSES] = {[PLANNED] = hash_bytes("one", 3)};
    assign_by_plans(b, JOB, 0, units, 1, plans);
    load(b, JOB);
    assert_int_equal(await_duty(b, DUTY_PLAN, NEVER).pass, PLANNED);
    plans[PLANNED] = hash_bytes("another", 7);
    assign_by_plans(b, JOB, 0, units + 1, 1, plans);
    assert_int_equal(await_duty(b, DUTY_LOAD, NEVER).assignment.job, JOB);
    load(b, JOB);
    duty_t duty = await_duty(b, DUTY_PLAN, NEVER);
    assert_true(hash_equal(&duty.assignment.plans[PLANNED], &plans[PLANNED]));
}

int main(void)
{
#define WITH_FIXTURE(test) cmocka_unit_test_setup_teardown(test, set_up, tear_down)
    const struct CMUnitTest tests[] = {
        WITH_FIXTURE(units_become_a_batch),
        WITH_FIXTURE(an_offered_batch_grows_until_it_is_closed),
        WITH_FIXTURE(a_batch_waits_for_nothing_when_nothing_comes),
        WITH_FIXTURE(samples_in_hand_are_not_rendered_again),
        WITH_FIXTURE(a_check_keeps_lessons_and_splats_once),
        WITH_FIXTURE(a_check_makes_a_batch_of_its_own),
        WITH_FIXTURE(a_check_can_be_the_first_assignment),
        WITH_FIXTURE(a_forgotten_worker_keeps_what_was_begun),
        WITH_FIXTURE(a_job_that_is_over_is_dropped),
        WITH_FIXTURE(a_paused_job_goes_on_without_loading),
        WITH_FIXTURE(another_job_waits_for_the_last_batch),
        WITH_FIXTURE(a_number_alone_does_not_make_a_job),
        WITH_FIXTURE(draining_finishes_what_was_begun),
        WITH_FIXTURE(units_that_take_too_long_are_given_up),
        WITH_FIXTURE(rendering_pauses_while_the_batch_is_full),
        WITH_FIXTURE(a_batch_fits_into_a_message),
        WITH_FIXTURE(units_that_wait_keep_their_macs),
        WITH_FIXTURE(a_film_beyond_the_memory_is_declined),
        WITH_FIXTURE(a_scene_that_cannot_be_loaded_is_declined),
        WITH_FIXTURE(a_slow_link_bounds_what_is_in_hand),
        WITH_FIXTURE(a_job_that_memory_is_missing_for_is_declined),
        WITH_FIXTURE(units_wait_for_their_plan),
        WITH_FIXTURE(batches_and_plans_take_turns),
        WITH_FIXTURE(a_check_waits_for_its_plan),
        WITH_FIXTURE(another_plan_makes_another_job),
    };
    return cmocka_run_group_tests_name("render_pool", tests, NULL, NULL);
}
