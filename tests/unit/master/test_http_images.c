/* Tests of images.c: a real master, a scripted worker, and the files that are asked for by HTTP. */
#include "common/image/image.h"
#include "master/http/access/tokens.h"
#include "master/master.h"
#include "tests/http_client.h"
#include "tests/peer.h"
#include "tests/scratch.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

typedef struct {
    char *folder;
    master_t *master;
    peer_t *peer;
    hash_t blob;
    int port;
    http_tokens_t tokens;
} trial_t;

static int set_up(void **state)
{
    trial_t *t = mem_zalloc(1, sizeof *t);
    log_init("test", LOG_ERROR);
    t->folder = scratch_new();
    master_options_t options = master_options_default();
    options.control_endpoint = options.bulk_endpoint = "tcp://127.0.0.1:*";
    options.data_dir = t->folder;
    options.http.listen = "0";
    assert_int_equal(master_start(&options, &t->master).code, RESULT_OK);
    assert_int_equal(sscanf(master_page_url(t->master), "http://127.0.0.1:%d/", &t->port), 1);
    assert_int_equal(http_tokens_read(t->folder, &t->tokens).code, RESULT_OK);
    t->peer = peer_new(master_control_port(t->master));
    uint64_t size;
    uint8_t *bytes = peer_blob(0, &size, &t->blob);
    assert_int_equal(peer_put_blob(t->peer, bytes, size, &t->blob, WIRE_MAX_CHUNK).code, RESULT_OK);
    free(bytes);
    peer_hello(t->peer, WIRE_VERSION, 1, NULL);
    *state = t;
    return 0;
}

static int tear_down(void **state)
{
    trial_t *t = *state;
    if (t->peer != NULL) peer_destroy(&t->peer);
    master_stop(&t->master);
    scratch_destroy(&t->folder);
    free(t);
    return 0;
}

/* A job of 8 samples a pixel that keeps an image at 4. */
static uint64_t submit(trial_t *t, int side)
{
    uint64_t job;
    job_settings_t settings = job_settings_default();
    settings.width = settings.height = side;
    settings.tile_size = 256;
    settings.spp = 8;
    settings.save_at = (save_at_t){.count = 1, .spp = {4}};
    assert_int_equal(peer_submit(t->peer, "a \"test\"", &settings, &t->blob, &job).code, RESULT_OK);
    return job;
}

/* Renders so many samples a pixel. */
static void render(trial_t *t, uint64_t job, int side, uint32_t spp)
{
    for (uint64_t left = (uint64_t)side * (uint64_t)side * spp; left > 0;) {
        peer_work_t work;
        peer_work(t->peer, left, (uint64_t)side * (uint64_t)side * spp, &work);
        if (work.job != job) continue; /* the image of a milestone is being written */
        batch_t batch = peer_render(&work.settings, work.units, work.unit_count);
        result_t result = peer_send_batch(t->peer, job, &batch);
        if (result.code != RESULT_OK) fail_msg("%s", result.message);
        for (size_t i = 0; i < work.unit_count; i++) left -= unit_samples(&work.settings, &work.units[i]);
        batch_free(&batch);
    }
}

static http_answer_t ask(trial_t *t, const char *path, const char *tag)
{
    char *lines = mem_printf("Host: localhost\r\nAuthorization: Bearer %s\r\n%s%s%s", t->tokens.view,
                             tag ? "If-None-Match: " : "", tag ? tag : "", tag ? "\r\n" : "");
    http_answer_t answer = http_ask_raw(t->port, "GET", path, lines, NULL);
    free(lines);
    return answer;
}

static void tag_of(const http_answer_t *answer, char tag[200])
{
    const char *line = strstr(answer->head, "\r\nETag: ");
    assert_non_null(line);
    assert_int_equal(sscanf(line, "\r\nETag: %199[^\r]", tag), 1);
}

/* The answer must be this file, byte by byte. */
static void assert_file(http_answer_t answer, const char *type, const char *path)
{
    size_t size;
    uint8_t *bytes = scratch_read(path, &size);
    assert_int_equal(answer.status, 200);
    assert_non_null(strstr(answer.head, type));
    assert_int_equal(answer.size, size);
    assert_memory_equal(answer.body, bytes, size);
    http_answer_free(&answer);
    free(bytes);
}

static hash_t pixels_of(const http_answer_t *answer, pixel_type_t *type)
{
    image_t image;
    result_t result = image_decode_exr("the answer", (uint8_t *)answer->body, answer->size, &image);
    if (result.code != RESULT_OK) fail_msg("%s\n%s", answer->head, result.message);
    hash_t hash = image_hash(&image);
    *type = image_find(&image, "R")->type;
    image_free(&image);
    return hash;
}

/* ---- what is sent -------------------------------------------------------------------------------------- */

static void a_finished_image_is_the_file(void **state)
{
    trial_t *t = *state;
    uint64_t job = submit(t, 64);
    render(t, job, 64, 8);
    assert_int_equal(peer_wait(t->peer, job, 10), JOB_DONE);
    char *final = scratch_path(t->folder, "job-1.exr"), *at = scratch_path(t->folder, "job-1-at-4.exr");
    http_answer_t answer = ask(t, "/api/v1/jobs/1/image.exr", NULL);
    assert_non_null(
        strstr(answer.head, "\r\nContent-Disposition: attachment; filename=\"a__test_.exr\"\r\n"));
    assert_non_null(strstr(answer.head, "\r\nCache-Control: no-store\r\n"));
    assert_file(answer, "Content-Type: image/x-exr", final);
    answer = ask(t, "/api/v1/jobs/1/image.exr?at=4", NULL);
    assert_non_null(strstr(answer.head, "filename=\"a__test_-0004.exr\""));
    assert_file(answer, "Content-Type: image/x-exr", at);
    pixel_type_t type;
    answer = ask(t, "/api/v1/jobs/1/image.exr?half=1", NULL);
    pixels_of(&answer, &type);
    assert_int_equal(type, PIXEL_HALF);
    http_answer_free(&answer);
    free(final);
    free(at);
}

static void expect_halves(trial_t *t, const char *path, bool halves)
{
    http_answer_t answer = ask(t, path, NULL);
    image_t image;
    result_t result = image_decode_exr("it", (uint8_t *)answer.body, answer.size, &image);
    if (result.code != RESULT_OK) fail_msg("%s: %s", path, answer.body);
    assert_int_equal(image_find(&image, "half1.R") != NULL, halves);
    image_free(&image);
    http_answer_free(&answer);
}

/* A film has them; an image that was kept on the way has them only if they were wanted from the start. */
static void the_halves_are_layers(void **state)
{
    trial_t *t = *state;
    uint64_t job = submit(t, 64);
    render(t, job, 64, 4);
    expect_halves(t, "/api/v1/jobs/1/image.exr?halves=1", true);
    expect_halves(t, "/api/v1/jobs/1/image.exr", false);
    render(t, job, 64, 4);
    assert_int_equal(peer_wait(t->peer, job, 10), JOB_DONE);
    expect_halves(t, "/api/v1/jobs/1/image.exr?halves=1", true);
    expect_halves(t, "/api/v1/jobs/1/image.exr", false);
    http_answer_t answer = ask(t, "/api/v1/jobs/1/image.exr?at=4&halves=1", NULL);
    assert_int_equal(answer.status, 409);
    assert_non_null(strstr(answer.body, "submitted without --halves"));
    http_answer_free(&answer);
}

/* The PNG is the one that the command makes of the EXR. */
static void a_png_is_that_of_the_command(void **state)
{
    trial_t *t = *state;
    uint64_t job = submit(t, 64);
    const struct {
        const char *query, *exr;
        float exposure;
    } cases[] = {{"", "now.exr", 0},
                 {"?exposure=-1.5", "now.exr", -1.5f},
                 {"?at=4", "job-1-at-4.exr", 0},
                 {"", "job-1.exr", 0},
                 {"?exposure=2", "job-1.exr", 2}};
    char *now = scratch_path(t->folder, "now.exr"), *png = scratch_path(t->folder, "want.png");
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++) {
        if (i == 0) render(t, job, 64, 4);
        if (i == 3) render(t, job, 64, 4);
        if (i == 0) assert_int_equal(peer_fetch(t->peer, job, false, WIRE_MAX_CHUNK, now).code, RESULT_OK);
        if (i == 3) assert_int_equal(peer_wait(t->peer, job, 10), JOB_DONE);
        char *path = mem_printf("/api/v1/jobs/1/image.png%s", cases[i].query);
        char *exr = scratch_path(t->folder, cases[i].exr);
        image_t image;
        assert_int_equal(image_read_exr(exr, &image).code, RESULT_OK);
        assert_int_equal(image_write_png(png, &image, cases[i].exposure).code, RESULT_OK);
        image_free(&image);
        assert_file(ask(t, path, NULL), "Content-Type: image/png", png);
        free(exr);
        free(path);
    }
    free(now);
    free(png);
}

static void an_image_is_sent_again_only_when_it_has_changed(void **state)
{
    trial_t *t = *state;
    uint64_t job = submit(t, 64);
    const char *path = "/api/v1/jobs/1/image.exr";
    char tag[200], later[200];
    pixel_type_t type;
    render(t, job, 64, 2);
    http_answer_t first = ask(t, path, NULL), same = {0};
    assert_int_equal(first.status, 200);
    tag_of(&first, tag);
    same = ask(t, path, tag);
    assert_int_equal(same.status, 304);
    assert_int_equal(same.size, 0);
    http_answer_free(&same);
    assert_int_equal(http_status_of(ask(t, "/api/v1/jobs/1/image.exr?half=1", tag)), 200); /* another file */
    assert_int_equal(http_status_of(ask(t, "/api/v1/jobs/1/image.png", tag)), 200);
    render(t, job, 64, 1);
    same = ask(t, path, tag);
    assert_int_equal(same.status, 200);
    tag_of(&same, later);
    assert_string_not_equal(tag, later);
    hash_t before = pixels_of(&first, &type), after = pixels_of(&same, &type);
    assert_false(hash_equal(&before, &after));
    http_answer_free(&first);
    http_answer_free(&same);
}

/* ---- what is refused ----------------------------------------------------------------------------------- */

static void what_is_not_there_is_refused_with_the_reason(void **state)
{
    trial_t *t = *state;
    submit(t, 64);
    const struct {
        const char *path, *reason;
        int status;
    } cases[] = {{"1/image.exr", "no samples yet", 409},
                 {"1/image.png", "no samples yet", 409},
                 {"2/image.exr", "no job 2", 404},
                 {"1/image.exr?at=4", "no image at 4 samples a pixel yet", 409},
                 {"1/image.exr?at=5", "submit it with --save-at 5", 409},
                 {"1/image.exr?at=0", "at is a whole number from 1", 400},
                 {"1/image.exr?half=yes", "half is a whole number", 400},
                 {"1/image.exr?halves=2", "halves is a whole number", 400},
                 {"1/image.exr?exposure=1", "no 'exposure' to ask for", 400},
                 {"1/image.png?half=1", "no 'half' to ask for", 400},
                 {"1/image.png?exposure=51", "exposure is a number of stops", 400},
                 {"1/image.png?exposure=nan", "exposure is a number of stops", 400},
                 {"1/image.png?exposure=", "exposure is a number of stops", 400},
                 {"1/image.jpg", "nothing at this path", 404}};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++) {
        char *path = mem_printf("/api/v1/jobs/%s", cases[i].path);
        http_answer_t answer = ask(t, path, NULL);
        if (answer.status != cases[i].status || strstr(answer.body, cases[i].reason) == NULL)
            fail_msg("%s: %d %s", cases[i].path, answer.status, answer.body);
        http_answer_free(&answer);
        free(path);
    }
    assert_int_equal(http_status_of(http_ask(t->port, "GET", "/api/v1/jobs/1/image.exr", NULL, NULL)), 401);
}

/* ---- who does not read, and who goes away ---------------------------------------------------------------
 */

enum { LARGE = 512 }; /* pixels a side: writing the image takes a moment */

static int begin_to_ask(trial_t *t)
{
    char *bytes = mem_printf("GET /api/v1/jobs/1/image.exr HTTP/1.1\r\nHost: localhost\r\n"
                             "Authorization: Bearer %s\r\n\r\n",
                             t->tokens.view);
    int connection = http_open(t->port, bytes);
    free(bytes);
    return connection;
}

/* Waits until this process, the master included, has as few open files as before. */
static void assert_files_closed(size_t before)
{
    for (int i = 0; i < 1000 && scratch_count("/proc/self/fd") > before; i++) usleep(10000);
    assert_in_range(scratch_count("/proc/self/fd"), 0, before);
}

static void too_many_readers_are_asked_to_come_back(void **state)
{
    trial_t *t = *state;
    uint64_t job = submit(t, 64);
    render(t, job, 64, 8);
    assert_int_equal(peer_wait(t->peer, job, 10), JOB_DONE);
    char *final = scratch_path(t->folder, "job-1.exr");
    assert_int_equal(truncate(final, 64 << 20), 0); /* more bytes than sockets hold */
    free(final);
    assert_int_equal(http_status_of(ask(t, "/api/v1/jobs/1/image.exr?at=4", NULL)), 200);
    size_t files = scratch_count("/proc/self/fd");
    int readers[32];
    for (size_t i = 0; i < ARRAY_LENGTH(readers); i++) readers[i] = begin_to_ask(t);
    http_answer_t answer = {0};
    for (size_t i = 0; i < ARRAY_LENGTH(readers); i++) {
        char *head = http_read_until(readers[i], "HTTP/1.1 200", 20);
        assert_non_null(head);
        free(head);
    }
    answer = ask(t, "/api/v1/jobs/1/image.exr", NULL);
    assert_int_equal(answer.status, 503);
    assert_non_null(strstr(answer.head, "\r\nRetry-After: "));
    http_answer_free(&answer);
    assert_int_equal(http_status_of(ask(t, "/api/v1/jobs", NULL)), 200); /* others go on */
    for (size_t i = 0; i < ARRAY_LENGTH(readers); i++) close(readers[i]);
    assert_files_closed(files);
    assert_int_equal(http_status_of(ask(t, "/api/v1/jobs/1/image.exr", NULL)), 200);
}

static void who_goes_away_leaves_nothing_behind(void **state)
{
    trial_t *t = *state;
    render(t, submit(t, LARGE), LARGE, 1);
    assert_int_equal(http_status_of(ask(t, "/api/v1/jobs/1/image.png", NULL)), 200);
    size_t files = scratch_count("/proc/self/fd");
    for (int i = 0; i < 40; i++) {
        int connection = begin_to_ask(t);
        if (i % 2 == 0) usleep(2000);
        close(connection);
    }
    assert_files_closed(files);
    assert_int_equal(http_status_of(ask(t, "/api/v1/jobs/1/image.exr", NULL)), 200);
}

static void the_master_ends_with_images_asked_for(void **state)
{
    trial_t *t = *state;
    render(t, submit(t, LARGE), LARGE, 1);
    int readers[20];
    for (size_t i = 0; i < ARRAY_LENGTH(readers); i++) readers[i] = begin_to_ask(t);
    usleep(20000);
    double start = clock_now();
    if (t->peer != NULL) peer_destroy(&t->peer);
    master_stop(&t->master);
    assert_true(clock_now() - start < 20);
    for (size_t i = 0; i < ARRAY_LENGTH(readers); i++) close(readers[i]);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(a_finished_image_is_the_file, set_up, tear_down),
        cmocka_unit_test_setup_teardown(the_halves_are_layers, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_png_is_that_of_the_command, set_up, tear_down),
        cmocka_unit_test_setup_teardown(an_image_is_sent_again_only_when_it_has_changed, set_up, tear_down),
        cmocka_unit_test_setup_teardown(what_is_not_there_is_refused_with_the_reason, set_up, tear_down),
        cmocka_unit_test_setup_teardown(too_many_readers_are_asked_to_come_back, set_up, tear_down),
        cmocka_unit_test_setup_teardown(who_goes_away_leaves_nothing_behind, set_up, tear_down),
        cmocka_unit_test_setup_teardown(the_master_ends_with_images_asked_for, set_up, tear_down),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
