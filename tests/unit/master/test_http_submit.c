/* Tests of uploads.c and of submissions (orders.c, parse/bodies.c): a real master, to which scenes and jobs
 * come by HTTP. */
#include "common/scene/blob_builder.h"
#include "common/scene/overrides.h"
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
#include <sys/socket.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

typedef struct {
    char *folder;
    master_t *master;
    int port;
    http_tokens_t tokens;
    uint8_t *blob; /* of several pieces */
    uint64_t size;
    hash_t hash;
    char path[120]; /* of the blob in the API, */
    char hex[2 * HASH_BYTES + 1];
} trial_t;

static void begin(trial_t *t)
{
    master_options_t options = master_options_default();
    options.control_endpoint = options.bulk_endpoint = "tcp://127.0.0.1:*";
    options.data_dir = t->folder;
    options.http.listen = "0";
    options.blob_limit = 20000000;
    assert_int_equal(master_start(&options, &t->master).code, RESULT_OK);
    assert_int_equal(sscanf(master_page_url(t->master), "http://127.0.0.1:%d/", &t->port), 1);
    assert_int_equal(http_tokens_read(t->folder, &t->tokens).code, RESULT_OK);
}

/* A scene with an image of 4 MiB that nothing shows. */
static void make_blob(trial_t *t)
{
    enum { SIDE = 1024 };
    blob_builder_t *builder = blob_builder_new();
    blob_scene_t scene = blob_default_scene();
    scene.width = 72;
    scene.height = 48;
    scene.spp = 12;
    scene.max_depth = 3;
    blob_object_t world = {0};
    blob_image_t image = {.format = TEXELS_RGBA8, .width = SIDE, .height = SIDE};
    uint32_t *texels = mem_alloc((size_t)SIDE * SIDE * sizeof *texels);
    for (uint32_t i = 0; i < SIDE * SIDE; i++) texels[i] = i * 2654435761u;
    blob_builder_add(builder, BLOB_SECTION_SCENE, &scene, 1);
    blob_builder_add(builder, BLOB_SECTION_OBJECTS, &world, 1);
    const blob_light_t lights[] = {{.kind = LIGHT_POINT, .world_from_light = xform_identity()},
                                   {.kind = LIGHT_DISTANT, .world_from_light = xform_identity()}};
    blob_builder_add(builder, BLOB_SECTION_LIGHTS, lights, 2);
    blob_builder_add(builder, BLOB_SECTION_IMAGES, &image, 1);
    blob_builder_add(builder, BLOB_SECTION_TEXELS, texels, SIDE * SIDE);
    result_t result = blob_builder_finish(builder, &t->blob, &t->size);
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
    blob_builder_destroy(&builder);
    free(texels);
    t->hash = hash_bytes(t->blob, t->size);
    hash_to_hex(&t->hash, t->hex);
    snprintf(t->path, sizeof t->path, "/api/v1/blobs/%s", t->hex);
}

static int set_up(void **state)
{
    trial_t *t = mem_zalloc(1, sizeof *t);
    log_init("test", LOG_ERROR);
    t->folder = scratch_new();
    begin(t);
    make_blob(t);
    *state = t;
    return 0;
}

static int tear_down(void **state)
{
    trial_t *t = *state;
    master_stop(&t->master);
    scratch_destroy(&t->folder);
    free(t->blob);
    free(t);
    return 0;
}

/* ---- requests ------------------------------------------------------------------------------------------ */

/* Begins a PUT with these lines, and sends so many bytes. */
static int open_put(trial_t *t, const char *token, const char *lines, const uint8_t *bytes, uint64_t count)
{
    char *head = mem_printf("PUT %s HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer %s\r\n%s"
                            "Connection: close\r\n\r\n",
                            t->path, token, lines);
    int connection = http_open(t->port, head);
    free(head);
    for (uint64_t sent = 0; sent < count;) {
        ssize_t more = send(connection, bytes + sent, count - sent, MSG_NOSIGNAL);
        if (more <= 0) break; /* refused, and closed */
        sent += (uint64_t)more;
    }
    return connection;
}

/* The status of the answer, whose text is in *said if that is not NULL. */
static int read_status(int connection, char **said)
{
    int status = 0;
    char *text = http_read_until(connection, "}", 30);
    close(connection);
    if (text == NULL) fail_msg("no answer");
    assert_int_equal(sscanf(text, "HTTP/1.1 %d", &status), 1);
    if (said != NULL)
        *said = text;
    else
        free(text);
    return status;
}

/* Sends bytes [first, last) of a blob of `size`, with a range unless it is the whole. */
static int put(trial_t *t, const uint8_t *bytes, uint64_t first, uint64_t end, uint64_t size, char **said)
{
    unsigned long long from = first, to = end - 1, all = size, length = end - first;
    bool whole = first == 0 && end == size;
    char *range =
        whole ? mem_strdup("") : mem_printf("Content-Range: bytes %llu-%llu/%llu\r\n", from, to, all);
    char *lines = mem_printf("Content-Length: %llu\r\n%s", length, range);
    int status = read_status(open_put(t, t->tokens.operate, lines, bytes + first, end - first), said);
    free(range);
    free(lines);
    return status;
}

static void expect_put(trial_t *t, uint64_t first, uint64_t end, int status)
{
    char *said;
    int got = put(t, t->blob, first, end, t->size, &said);
    if (got != status) fail_msg("%d: %s", got, said);
    free(said);
}

/* How many bytes of the blob the master has; -1: none. */
static json_int_t there(trial_t *t, bool *complete)
{
    http_answer_t answer = http_ask(t->port, "GET", t->path, t->tokens.view, NULL);
    if (answer.status == 404) {
        http_answer_free(&answer);
        return -1;
    }
    json_t *object = http_json_of(answer, 200);
    json_int_t next = json_integer_value(json_object_get(object, "next"));
    *complete = json_is_true(json_object_get(object, "complete"));
    assert_string_equal(json_string_value(json_object_get(object, "blob")), t->hex);
    json_decref(object);
    return next;
}

static http_answer_t submit(trial_t *t, const char *members)
{
    char *body = mem_printf("{\"blob\": \"%s\"%s%s}", t->hex, members[0] ? ", " : "", members);
    http_answer_t answer = http_ask(t->port, "POST", "/api/v1/jobs", t->tokens.operate, body);
    free(body);
    return answer;
}

/* ---- uploads ------------------------------------------------------------------------------------------- */

static void a_blob_is_sent_whole(void **state)
{
    trial_t *t = *state;
    bool complete;
    assert_int_equal(there(t, &complete), -1);
    expect_put(t, 0, t->size, 201);
    assert_int_equal(there(t, &complete), t->size);
    assert_true(complete);
    expect_put(t, 0, t->size, 200); /* again: it is there */
    char *lines = mem_printf("Content-Length: %llu\r\nExpect: 100-continue\r\n", (unsigned long long)t->size);
    assert_int_equal(read_status(open_put(t, t->tokens.operate, lines, t->blob, 0), NULL),
                     200); /* without a byte */
    free(lines);
    char *path = mem_printf("%s/blobs/%s.blob", t->folder, t->hex);
    size_t size;
    uint8_t *bytes = scratch_read(path, &size);
    assert_int_equal(size, t->size);
    assert_memory_equal(bytes, t->blob, size);
    free(bytes);
    free(path);
}

static void a_blob_is_sent_in_pieces(void **state)
{
    trial_t *t = *state;
    bool complete;
    uint64_t third = t->size / 3;
    expect_put(t, 0, third, 202);
    assert_int_equal(there(t, &complete), third);
    assert_false(complete);
    expect_put(t, 2 * third, t->size, 409);   /* there is a gap */
    expect_put(t, third / 2, 2 * third, 202); /* a part of it is there */
    assert_int_equal(there(t, &complete), 2 * third);
    expect_put(t, 0, third, 202); /* sent again: nothing changes */
    assert_int_equal(there(t, &complete), 2 * third);
    expect_put(t, 2 * third, t->size, 201);
    assert_int_equal(there(t, &complete), t->size);
    assert_true(complete);
}

/* The connection breaks in the middle; the master ends in the middle; then the rest comes, as a whole. */
static void a_broken_upload_goes_on(void **state)
{
    trial_t *t = *state;
    bool complete;
    char *lines = mem_printf("Content-Length: %llu\r\n", (unsigned long long)t->size);
    json_int_t came = -1,
               pieces = (json_int_t)((t->size - 1000) >> 20 << 20); /* that are written one by one */
    size_t files = scratch_count("/proc/self/fd");
    int connection = open_put(t, t->tokens.operate, lines, t->blob, t->size - 1000);
    for (int i = 0; i < 1000 && came < pieces; i++, usleep(10000)) came = there(t, &complete);
    assert_int_equal(came, pieces);
    close(connection);
    for (int i = 0; i < 1000 && scratch_count("/proc/self/fd") > files; i++) usleep(10000);
    assert_in_range(scratch_count("/proc/self/fd"), 0, files);
    master_stop(&t->master);
    begin(t);
    assert_int_equal(there(t, &complete), came);
    assert_false(complete);
    expect_put(t, 0, t->size, 201);
    free(lines);
}

static void wrong_bytes_leave_nothing_behind(void **state)
{
    trial_t *t = *state;
    bool complete;
    char *said;
    t->blob[t->size / 2] ^= 1;
    assert_int_equal(put(t, t->blob, 0, t->size, t->size, &said), 422);
    assert_non_null(strstr(said, "application/problem+json"));
    free(said);
    assert_int_equal(there(t, &complete), -1);
    t->blob[t->size / 2] ^= 1;
    expect_put(t, 0, 2000000, 202);
    assert_int_equal(put(t, t->blob, 0, 1000, t->size + 1, NULL),
                     202); /* another size: it is asked for more */
    expect_put(t, 0, t->size, 201);
}

/* A part that came whole, but was not checked since the master was killed. */
static void what_is_there_is_checked(void **state)
{
    trial_t *t = *state;
    bool complete;
    char *part = mem_printf("%s/blobs/%s.part", t->folder, t->hex);
    scratch_write(part, t->blob, t->size);
    assert_int_equal(there(t, &complete), t->size);
    assert_false(complete);
    expect_put(t, 0, t->size, 201);
    there(t, &complete);
    assert_true(complete);
    free(part);
}

static void uploads_need_the_token_to_operate(void **state)
{
    trial_t *t = *state;
    bool complete;
    const char *lines = "Content-Length: 4\r\n";
    assert_int_equal(read_status(open_put(t, "x", lines, t->blob, 4), NULL), 401);
    assert_int_equal(read_status(open_put(t, t->tokens.view, lines, t->blob, 4), NULL), 403);
    const char *foreign = "Content-Length: 4\r\nOrigin: http://evil.example\r\n";
    assert_int_equal(read_status(open_put(t, t->tokens.operate, foreign, t->blob, 4), NULL), 403);
    assert_int_equal(http_status_of(http_ask(t->port, "GET", t->path, NULL, NULL)), 401);
    assert_int_equal(http_status_of(http_ask(t->port, "POST", "/api/v1/jobs", t->tokens.view, "{}")), 403);
    assert_int_equal(there(t, &complete), -1);
}

static void wrong_uploads_are_refused(void **state)
{
    trial_t *t = *state;
    const struct {
        const char *lines;
        int status;
    } cases[] = {{"Transfer-Encoding: chunked\r\n", 411},
                 {"Content-Length: 0\r\n", 413},
                 {"Content-Length: 68719476737\r\n", 413},
                 {"Content-Length: 30000000\r\nContent-Range: bytes 0-3/4\r\n", 400},
                 {"Content-Length: 4\r\nContent-Range: bytes 0-4/9\r\n", 400},
                 {"Content-Length: 4\r\nContent-Range: bytes 0-3/*\r\n", 400},
                 {"Content-Length: 4\r\nContent-Range: bytes 6-9/9\r\n", 400},
                 {"Content-Length: 4\r\nContent-Range: bytes 9-6/20\r\n", 400},
                 {"Content-Length: 4\r\nContent-Range: 0-3/9\r\n", 400},
                 {"Content-Length: 4\r\nContent-Range: bytes 3-6/9\r\n", 409},
                 {"Content-Length: 4\r\nContent-Range: bytes 0-3/20000001\r\n", 507}, /* over --blob-limit */
                 {"Content-Length: 4\r\n", 422}};                                     /* no scene */
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++) {
        int status = read_status(open_put(t, t->tokens.operate, cases[i].lines, t->blob, 4), NULL);
        if (status != cases[i].status) fail_msg("%s: %d", cases[i].lines, status);
    }
    t->path[strlen(t->path) - 1] = '\0';
    assert_int_equal(read_status(open_put(t, t->tokens.operate, "Content-Length: 4\r\n", t->blob, 4), NULL),
                     404);
}

static void eight_uploads_go_at_a_time(void **state)
{
    trial_t *t = *state;
    int uploads[8];
    char *lines = mem_printf("Content-Length: %llu\r\n", (unsigned long long)t->size);
    for (size_t i = 0; i < ARRAY_LENGTH(uploads); i++)
        uploads[i] = open_put(t, t->tokens.operate, lines, t->blob, 100);
    char *said;
    int status = 0;
    for (int i = 0; i < 500 && status != 503; i++, usleep(10000)) { /* until the eight are heard */
        status = read_status(open_put(t, t->tokens.operate, lines, t->blob, i == 0 ? 0 : 10), &said);
        if (status == 503) assert_non_null(strstr(said, "\r\nRetry-After: "));
        free(said);
    }
    assert_int_equal(status, 503);
    for (size_t i = 0; i < ARRAY_LENGTH(uploads); i++) close(uploads[i]);
    for (int i = 0; i < 500 && status == 503; i++, usleep(10000))
        status = put(t, t->blob, 0, t->size, t->size, NULL);
    assert_int_equal(status, 201);
    free(lines);
}

/* The same blob by HTTP, twice, and by the other way, all at a time. */
static void uploads_of_one_blob_do_not_disturb_each_other(void **state)
{
    trial_t *t = *state;
    bool complete;
    char *lines = mem_printf("Content-Length: %llu\r\n", (unsigned long long)t->size);
    peer_t *peer = peer_new(master_control_port(t->master));
    int one = open_put(t, t->tokens.operate, lines, t->blob, t->size / 2);
    int other = open_put(t, t->tokens.operate, lines, t->blob, t->size / 2);
    assert_int_equal(peer_put_blob(peer, t->blob, t->size, &t->hash, 100000).code, RESULT_OK);
    assert_int_equal(send(one, t->blob + t->size / 2, t->size - t->size / 2, MSG_NOSIGNAL),
                     t->size - t->size / 2);
    assert_int_equal(send(other, t->blob + t->size / 2, t->size - t->size / 2, MSG_NOSIGNAL),
                     t->size - t->size / 2);
    assert_int_equal(read_status(one, NULL) / 100, 2);
    assert_int_equal(read_status(other, NULL) / 100, 2);
    assert_int_equal(there(t, &complete), t->size);
    assert_true(complete);
    peer_destroy(&peer);
    free(lines);
}

/* ---- submissions --------------------------------------------------------------------------------------- */

static void expect_job(trial_t *t, const char *members, const char *format, ...)
{
    char want[300];
    va_list values;
    va_start(values, format);
    vsnprintf(want, sizeof want, format, values);
    va_end(values);
    http_answer_t answer = submit(t, members);
    unsigned long long job;
    if (answer.status != 201 || strstr(answer.body, want) == NULL)
        fail_msg("%s: %d\n%s\nlacks %s", members, answer.status, answer.body, want);
    const char *location = strstr(answer.head, "\r\nLocation: /api/v1/jobs/");
    assert_non_null(location);
    assert_int_equal(sscanf(location, "\r\nLocation: /api/v1/jobs/%llu\r", &job), 1);
    char *path = mem_printf("/api/v1/jobs/%llu", job);
    assert_int_equal(http_status_of(http_ask(t->port, "GET", path, t->tokens.view, NULL)), 200);
    free(path);
    http_answer_free(&answer);
}

static void a_job_is_as_its_scene_and_its_submission_say(void **state)
{
    trial_t *t = *state;
    expect_put(t, 0, t->size, 201);
    expect_job(t, "", "\"name\":\"%.12s\"", t->hex);
    expect_job(t, "", "\"width\":72,\"height\":48,\"max_depth\":3,\"spp\":12,");
    expect_job(t, "\"name\": \"a \\u00e4\"", "\"name\":\"a \xc3\xa4\"");
    expect_job(t, "\"spp\": 64", "\"spp\":64,\"time_limit\":0.0,\"error_target\":0.0,");
    expect_job(t, "\"error\": 0.01", "\"spp\":%d,\"time_limit\":0.0,\"error_target\":0.01,", JOB_MAX_SPP);
    expect_job(t, "\"error\": 0.01, \"spp\": 9", "\"spp\":9,");
    expect_job(t, "\"time\": 60", "\"spp\":%d,\"time_limit\":60.0", JOB_MAX_SPP);
    expect_job(t, "\"width\": 10, \"height\": 20", "\"width\":10,\"height\":20,");
    expect_job(t, "\"integrator\": \"path\", \"sampler\": \"independent\"",
               "\"integrator\":\"path\",\"sampler\":\"independent\"");
    expect_job(t, "\"integrator\": \"vcm\", \"merge_radius\": 0.5", "\"merge_radius\":0.5");
    expect_job(t, "\"seed\": 7", "\"seed\":7,");
    expect_job(t, "\"seed\": \"9007199254740993\"", "\"seed\":9007199254740993,");
    expect_job(t, "\"seed\": \"18446744073709551615\"", "\"seed\":\"18446744073709551615\"");
    expect_job(t, "\"max_depth\": 0", "\"max_depth\":0,");
    expect_job(t, "\"adaptive\": true, \"spp\": 64", "\"adaptive\":true");
    expect_job(t, "\"save_at\": [2, 8]", "\"save_at\":[2,8]");
    expect_job(t, "\"layers\": false", "\"layers\":false");
    expect_job(t, "\"light_groups\": \"kinds\"", "\"light_groups\":\"point=point,distant=distant\"");
    expect_job(t, "\"light_groups\": \"a=1\"", "\"light_groups\":\"a=1,rest\"");
    expect_job(t, "", "\"light_groups\":\"\"");
    expect_job(t, "\"cryptomatte\": true", "\"cryptomatte\":true");
    expect_job(t, "\"priority\": -3, \"verify\": 0.5, \"mixed\": true, \"halves\": true",
               "\"priority\":-3,\"verify\":0.5,\"mixed\":true,\"halves\":true");
    expect_job(t, "\"tile_size\": 64, \"film_scale\": 20", "\"state\":\"queued\"");
}

/* What a client of the command line would make of the same scene. */
static void the_settings_are_those_of_the_command(void **state)
{
    trial_t *t = *state;
    expect_put(t, 0, t->size, 201);
    http_status_of(submit(t, "\"adaptive\": true, \"spp\": 64, \"tile_size\": 16"));
    overrides_t overrides = overrides_none();
    overrides.adaptive = true;
    overrides.spp = 64;
    overrides.tile_size = 16;
    scene_blob_t blob;
    job_settings_t want, got;
    assert_int_equal(blob_open(t->blob, t->size, &blob).code, RESULT_OK);
    assert_int_equal(overrides_apply(&overrides, &blob, &want).code, RESULT_OK);
    peer_t *peer = peer_new(master_control_port(t->master));
    wire_message_t message;
    assert_int_equal(wire_settings_get(peer_status(peer, 1, &message)->settings, &got).code, RESULT_OK);
    wire_free(&message);
    peer_destroy(&peer);
    assert_int_equal(got.film_scale, want.film_scale);
    assert_int_equal(got.tile_size, want.tile_size);
    hash_t a = job_content_hash(&want, &t->hash), b = job_content_hash(&got, &t->hash);
    assert_true(hash_equal(&a, &b));
    assert_int_equal(got.spp, want.spp);
}

static void wrong_submissions_are_refused_with_the_reason(void **state)
{
    trial_t *t = *state;
    expect_put(t, 0, t->size, 201);
    const struct {
        const char *members, *reason;
    } cases[] = {{"\"samples\": 3", "knows no 'samples'"},
                 {"\"light_groups_\": []", "knows no 'light_groups_'"},
                 {"\"light_groups\": 1", "light_groups is a text of at most 511 bytes"},
                 {"\"light_groups\": \"a=7\"", "the scene has no light '7'; it has point (0), distant (1)"},
                 {"\"spp\": 0", "spp is a whole number from 1 to 1073741824"},
                 {"\"spp\": 1.5", "spp is"},
                 {"\"spp\": \"64\"", "spp is"},
                 {"\"spp\": 64, \"spp\": 65", "no JSON"},
                 {"\"error\": 2", "error is a number"},
                 {"\"time\": 0", "time is a number"},
                 {"\"width\": 64", "width and height belong together"},
                 {"\"width\": 40000, \"height\": 2", "width is"},
                 {"\"width\": 32768, \"height\": 32768", "pixels"},
                 {"\"integrator\": \"pathh\"", "integrator is one of bdpt, path, light, ao, vcm"},
                 {"\"integrator\": 1", "integrator is one of"},
                 {"\"merge_radius\": 0.5", "belongs to the integrator vcm"},
                 {"\"seed\": -1", "seed is"},
                 {"\"seed\": 1e30", "seed is"},
                 {"\"seed\": \"0x7\"", "seed is"},
                 {"\"seed\": \"18446744073709551616\"", "seed is"},
                 {"\"adaptive\": 1", "adaptive is true or false"},
                 {"\"save_at\": 16", "save_at is a list"},
                 {"\"save_at\": [8, 4]", "save_at is a list"},
                 {"\"save_at\": [2, \"4\"]", "save_at is a list"},
                 {"\"save_at\": [64]", "an image is to be kept at 64"},
                 {"\"save_at\": [4], \"adaptive\": true", "adaptive"},
                 {"\"priority\": 1001", "priority is"},
                 {"\"verify\": 1.5", "verify is"},
                 {"\"name\": \"\"", "name is a text"},
                 {"\"name\": 3", "name is a text"},
                 {"\"blob\": \"12\"", "no JSON"}};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++) {
        http_answer_t answer = submit(t, cases[i].members);
        if (answer.status != 400 || strstr(answer.body, cases[i].reason) == NULL)
            fail_msg("%s: %d %s", cases[i].members, answer.status, answer.body);
        http_answer_free(&answer);
    }
    char *name = mem_printf("\"name\": \"%0201d\"", 0);
    assert_int_equal(http_status_of(submit(t, name)), 400);
    free(name);
    const char *token = t->tokens.operate;
    assert_int_equal(http_status_of(http_ask(t->port, "POST", "/api/v1/jobs", token, "{\"spp\": 4}")), 400);
    assert_int_equal(http_status_of(http_ask(t->port, "POST", "/api/v1/jobs", token, "{\"blob\": \"12\"}")),
                     400);
    t->hex[0] = t->hex[0] == '0' ? '1' : '0'; /* a scene that the master does not have */
    assert_int_equal(http_status_of(submit(t, "")), 409);
    json_t *root = http_json_of(http_ask(t->port, "GET", "/api/v1/jobs", token, NULL), 200);
    assert_int_equal(json_array_size(json_object_get(root, "jobs")), 0);
    json_decref(root);
}

static void a_submitted_job_outlives_the_master(void **state)
{
    trial_t *t = *state;
    expect_put(t, 0, t->size, 201);
    expect_job(t, "\"name\": \"kept\"", "\"kept\"");
    master_stop(&t->master);
    begin(t);
    json_t *job = http_json_of(http_ask(t->port, "GET", "/api/v1/jobs/1", t->tokens.view, NULL), 200);
    assert_string_equal(json_string_value(json_object_get(job, "name")), "kept");
    assert_string_equal(json_string_value(json_object_get(job, "scene")), t->hex);
    json_decref(job);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(a_blob_is_sent_whole, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_blob_is_sent_in_pieces, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_broken_upload_goes_on, set_up, tear_down),
        cmocka_unit_test_setup_teardown(wrong_bytes_leave_nothing_behind, set_up, tear_down),
        cmocka_unit_test_setup_teardown(what_is_there_is_checked, set_up, tear_down),
        cmocka_unit_test_setup_teardown(uploads_need_the_token_to_operate, set_up, tear_down),
        cmocka_unit_test_setup_teardown(wrong_uploads_are_refused, set_up, tear_down),
        cmocka_unit_test_setup_teardown(eight_uploads_go_at_a_time, set_up, tear_down),
        cmocka_unit_test_setup_teardown(uploads_of_one_blob_do_not_disturb_each_other, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_job_is_as_its_scene_and_its_submission_say, set_up, tear_down),
        cmocka_unit_test_setup_teardown(the_settings_are_those_of_the_command, set_up, tear_down),
        cmocka_unit_test_setup_teardown(wrong_submissions_are_refused_with_the_reason, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_submitted_job_outlives_the_master, set_up, tear_down),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
