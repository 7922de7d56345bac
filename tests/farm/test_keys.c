/* A farm with keys, in real processes over real sockets: who has no key that the master lists gets nothing
 * but a line in its log; a worker's key cannot do what is a client's, nor the other way round; keys are
 * exchanged while a job runs; and the picture is the same one. */
#include "tests/rig.h"
#include "tests/scratch.h"

#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

/* ---- the pieces ---------------------------------------------------------------------------------------- */

/* Everything that a program has written so far; fresh memory. */
static bool says(rig_t *rig, pid_t process, const char *text)
{
    char *output = rig_output(rig, process);
    bool found = strstr(output, text) != NULL;
    free(output);
    return found;
}

static void wait_until_says(rig_t *rig, pid_t process, const char *text)
{
    double deadline = clock_now() + 30;
    while (!says(rig, process, text)) {
        if (clock_now() > deadline) {
            char *output = rig_output(rig, process);
            fail_msg("waited for \"%s\" in\n%s", text, output);
        }
        rig_sleep(0.02);
    }
}

static void write_list(rig_t *rig, const char *text)
{
    /* As an editor does it: a new file in the place of the old one. */
    char *path = scratch_path(rig->keys, "allow"), *fresh = scratch_path(rig->keys, "allow.new");
    scratch_write(fresh, text, strlen(text));
    assert_int_equal(rename(fresh, path), 0);
    free(path);
    free(fresh);
}

static void open_key(rig_t *rig, const char *name, char key[KEY_TEXT + 1])
{
    char *file = mem_printf("%s.key", name), *path = scratch_path(rig->keys, file);
    assert_int_equal(key_file_read_open(path, key).code, RESULT_OK);
    free(path);
    free(file);
}

/* A socket that dials the master's control socket (or its bulk socket) as `name`, NULL: without keys,
 * believing that the master's key is that of `master`. */
typedef struct {
    void *context, *socket;
    uint64_t request;
} caller_t;

static caller_t call_as(rig_t *rig, const char *name, const char *master, bool bulk)
{
    caller_t caller = {.context = zmq_ctx_new()};
    char *endpoint = mem_printf("tcp://127.0.0.1:%d", rig->port + bulk);
    char *secret = name ? mem_printf("%s/%s.secret", rig->keys, name) : NULL;
    char *open = name ? mem_printf("%s/%s.key", rig->keys, master) : NULL;
    dial_options_t options = {.role = "client", .key = secret, .master_key = open, .insecure = name == NULL};
    dial_keys_t keys;
    int linger = 0;
    assert_int_equal(dial_keys_find(&options, "127.0.0.1", &keys).code, RESULT_OK);
    assert_int_equal(wire_socket(caller.context, ZMQ_DEALER, &caller.socket).code, RESULT_OK);
    assert_int_equal(dial_keys_apply(&keys, caller.socket).code, RESULT_OK);
    zmq_setsockopt(caller.socket, ZMQ_LINGER, &linger, sizeof linger);
    assert_int_equal(zmq_connect(caller.socket, endpoint), 0);
    dial_keys_free(&keys);
    free(endpoint);
    free(secret);
    free(open);
    return caller;
}

static void hang_up(caller_t *caller)
{
    zmq_close(caller->socket);
    zmq_ctx_term(caller->context);
}

/* A message that is as empty as its kind allows. */
static result_code_t send_kind(caller_t *caller, Lm__Envelope__BodyCase kind)
{
    static uint8_t hash[HASH_BYTES];
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    Lm__Hello hello = LM__HELLO__INIT;
    Lm__WorkRequest work = LM__WORK_REQUEST__INIT;
    Lm__Heartbeat beat = LM__HEARTBEAT__INIT;
    Lm__Goodbye goodbye = LM__GOODBYE__INIT;
    Lm__BatchResult batch = LM__BATCH_RESULT__INIT;
    Lm__BatchOffer offer = LM__BATCH_OFFER__INIT;
    Lm__Probe probe = LM__PROBE__INIT;
    Lm__BlobGet blob = LM__BLOB_GET__INIT;
    Lm__JobSubmit submit = LM__JOB_SUBMIT__INIT;
    Lm__JobStatusRequest status = LM__JOB_STATUS_REQUEST__INIT;
    Lm__JobOrder order = LM__JOB_ORDER__INIT;
    Lm__WorkerListRequest workers = LM__WORKER_LIST_REQUEST__INIT;
    Lm__BlobPut put = LM__BLOB_PUT__INIT;
    Lm__ImageGet image = LM__IMAGE_GET__INIT;
    hello.protocol_version = WIRE_VERSION;
    blob.blob = put.blob = (ProtobufCBinaryData){sizeof hash, hash};
    order.kind = ORDER_CANCEL;
    order.job = 99;
    image.snapshot = 99;
    envelope.request = ++caller->request;
    envelope.body_case = kind;
    switch (kind) {
#define BODY(KIND, field, value)                                                                             \
    case LM__ENVELOPE__BODY_##KIND:                                                                          \
        envelope.field = &(value);                                                                           \
        break
        BODY(HELLO, hello, hello);
        BODY(WORK_REQUEST, work_request, work);
        BODY(HEARTBEAT, heartbeat, beat);
        BODY(GOODBYE, goodbye, goodbye);
        BODY(BATCH_RESULT, batch_result, batch);
        BODY(BATCH_OFFER, batch_offer, offer);
        BODY(PROBE, probe, probe);
        BODY(BLOB_GET, blob_get, blob);
        BODY(JOB_SUBMIT, job_submit, submit);
        BODY(JOB_STATUS_REQUEST, job_status_request, status);
        BODY(JOB_ORDER, job_order, order);
        BODY(WORKER_LIST_REQUEST, worker_list_request, workers);
        BODY(BLOB_PUT, blob_put, put);
        BODY(IMAGE_GET, image_get, image);
#undef BODY
    default:
        fail_msg("no sample of kind %d", (int)kind);
    }
    zmq_msg_t payload;
    zmq_msg_init(&payload);
    return wire_send(caller->socket, NULL, 0, &envelope, &payload, 1).code;
}

/* The next answer; false when none comes in `seconds`. *code is that of a refusal, else RESULT_OK. */
static bool answered(caller_t *caller, double seconds, result_code_t *code)
{
    wire_message_t message;
    bool received = false;
    zmq_pollitem_t item = {.socket = caller->socket, .events = ZMQ_POLLIN};
    zmq_poll(&item, 1, (long)(1e3 * seconds));
    assert_int_equal(wire_receive(caller->socket, false, &message, &received).code, RESULT_OK);
    if (!received) return false;
    bool refusal = message.envelope->body_case == LM__ENVELOPE__BODY_REFUSAL;
    *code = refusal ? (result_code_t)message.envelope->refusal->code : RESULT_OK;
    wire_free(&message);
    return true;
}

static result_code_t ask_kind(caller_t *caller, Lm__Envelope__BodyCase kind)
{
    result_code_t code;
    assert_int_equal(send_kind(caller, kind), RESULT_OK);
    if (!answered(caller, 20, &code)) fail_msg("no answer for kind %d", (int)kind);
    return code;
}

/* ---- must-show: nothing without a listed key --------------------------------------------------------------
 */

static const Lm__Envelope__BodyCase CONTROL_WORK[] = {
    LM__ENVELOPE__BODY_HELLO, LM__ENVELOPE__BODY_WORK_REQUEST, LM__ENVELOPE__BODY_HEARTBEAT,
    LM__ENVELOPE__BODY_GOODBYE};
static const Lm__Envelope__BodyCase CONTROL_CLIENT[] = {
    LM__ENVELOPE__BODY_JOB_SUBMIT, LM__ENVELOPE__BODY_JOB_STATUS_REQUEST, LM__ENVELOPE__BODY_JOB_ORDER,
    LM__ENVELOPE__BODY_WORKER_LIST_REQUEST};
static const Lm__Envelope__BodyCase BULK_WORK[] = {LM__ENVELOPE__BODY_BATCH_RESULT,
                                                   LM__ENVELOPE__BODY_BATCH_OFFER,
                                                   LM__ENVELOPE__BODY_BLOB_GET, LM__ENVELOPE__BODY_PROBE};
static const Lm__Envelope__BodyCase BULK_CLIENT[] = {LM__ENVELOPE__BODY_BLOB_PUT,
                                                     LM__ENVELOPE__BODY_IMAGE_GET};

/* Sends messages of these kinds. When libzmq sees that the two sides do not speak the same it gives the
 * connection up, and there is nowhere to send the rest. */
static void send_kinds(caller_t *caller, const Lm__Envelope__BodyCase *kinds, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        result_code_t code = send_kind(caller, kinds[i]);
        assert_true(code == RESULT_OK || code == RESULT_LIMIT);
    }
}

/* Messages of every kind go unanswered. */
static void expect_silence(rig_t *rig, const char *name, const char *master)
{
    result_code_t code;
    caller_t control = call_as(rig, name, master, false), bulk = call_as(rig, name, master, true);
    send_kinds(&control, CONTROL_WORK, ARRAY_LENGTH(CONTROL_WORK));
    send_kinds(&control, CONTROL_CLIENT, ARRAY_LENGTH(CONTROL_CLIENT));
    send_kinds(&bulk, BULK_WORK, ARRAY_LENGTH(BULK_WORK));
    send_kinds(&bulk, BULK_CLIENT, ARRAY_LENGTH(BULK_CLIENT));
    assert_false(answered(&control, 1, &code));
    assert_false(answered(&bulk, 0.1, &code));
    hang_up(&control);
    hang_up(&bulk);
}

static void nothing_without_a_listed_key(void **state)
{
    (void)state;
    rig_t *rig = rig_new();
    rig_use_keys(rig);
    key_pair_t stranger, other;
    char refused[200];
    assert_int_equal(key_files_make(rig->keys, "stranger", &stranger).code, RESULT_OK);
    assert_int_equal(key_files_make(rig->keys, "other-master", &other).code, RESULT_OK);
    rig_start_master(rig, 0.5);
    expect_silence(rig, NULL, "master");
    expect_silence(rig, "stranger", "master");
    expect_silence(rig, "worker", "other-master");
    snprintf(refused, sizeof refused, "refused a connection from 127.0.0.1: the key %s is not in",
             stranger.open);
    wait_until_says(rig, rig->master, refused);
    wait_until_says(rig, rig->master, "refused a connection from 127.0.0.1 to the ");
    assert_false(says(rig, rig->master, "joins with"));
    assert_false(says(rig, rig->master, "malformed"));
    /* The right ones are served all the while. */
    caller_t worker = call_as(rig, "worker", "master", false);
    assert_int_equal(ask_kind(&worker, LM__ENVELOPE__BODY_HELLO), RESULT_OK);
    hang_up(&worker);
    rig_wait_workers(rig, 1);
    kill(rig->master, SIGTERM);
    assert_int_equal(rig_wait_exit(rig, rig->master, 30), 0);
    char *output = rig_output(rig, rig->master);
    assert_non_null(strstr(output, " 0 malformed"));
    free(output);
    rig_destroy(&rig);
}

/* ---- must-show: rights ------------------------------------------------------------------------------------
 */

static void expect_rights(rig_t *rig, const char *name, bool work, bool client)
{
    caller_t control = call_as(rig, name, "master", false), bulk = call_as(rig, name, "master", true);
    for (size_t i = 0; i < ARRAY_LENGTH(CONTROL_WORK); i++)
        assert_int_equal(ask_kind(&control, CONTROL_WORK[i]) != RESULT_DENIED, work);
    for (size_t i = 0; i < ARRAY_LENGTH(CONTROL_CLIENT); i++)
        assert_int_equal(ask_kind(&control, CONTROL_CLIENT[i]) != RESULT_DENIED, client);
    for (size_t i = 0; i < ARRAY_LENGTH(BULK_WORK); i++)
        assert_int_equal(ask_kind(&bulk, BULK_WORK[i]) != RESULT_DENIED, work);
    for (size_t i = 0; i < ARRAY_LENGTH(BULK_CLIENT); i++)
        assert_int_equal(ask_kind(&bulk, BULK_CLIENT[i]) != RESULT_DENIED, client);
    hang_up(&control);
    hang_up(&bulk);
}

static void a_key_has_the_rights_that_the_list_gives_it(void **state)
{
    (void)state;
    rig_t *rig = rig_new();
    char worker[KEY_TEXT + 1], client[KEY_TEXT + 1];
    rig_use_keys(rig);
    open_key(rig, "worker", worker);
    open_key(rig, "client", client);
    rig_start_master(rig, 0.5);
    job_settings_t settings = rig_settings();
    uint64_t job = rig_submit(rig, &settings);
    expect_rights(rig, "worker", true, false);
    expect_rights(rig, "client", false, true);

    /* The commands say it too. */
    char *address = mem_printf("127.0.0.1:%d", rig->port), *number = mem_printf("%d", (int)job);
    char *secret = scratch_path(rig->keys, "worker.secret"), *open = scratch_path(rig->keys, "master.key");
    const char *const cancel[] = {"cancel", number,         "--master", address, "--key",
                                  secret,   "--master-key", open,       NULL};
    pid_t process = rig_start_command(rig, cancel);
    assert_int_equal(rig_wait_exit(rig, process, 30), RESULT_DENIED);
    assert_true(says(rig, process, "may work, but not what this message asks for"));
    assert_int_equal(rig_status(rig, job).state, JOB_QUEUED);

    /* Rights change while connections last. */
    caller_t caller = call_as(rig, "worker", "master", false);
    assert_int_equal(ask_kind(&caller, LM__ENVELOPE__BODY_JOB_STATUS_REQUEST), RESULT_DENIED);
    char *list = mem_printf("all %s w\nclient %s c\n", worker, client);
    write_list(rig, list);
    kill(rig->master, SIGHUP);
    for (int i = 0; ask_kind(&caller, LM__ENVELOPE__BODY_JOB_STATUS_REQUEST) == RESULT_DENIED; i++) {
        assert_true(i < 200);
        rig_sleep(0.05);
    }
    /* A list with a mistake changes nothing, and is not passed over in silence. */
    write_list(rig, "client nonsense\n");
    wait_until_says(rig, rig->master, "allow:1: after the right comes a public key");
    assert_int_equal(ask_kind(&caller, LM__ENVELOPE__BODY_JOB_STATUS_REQUEST), RESULT_OK);
    /* Out of the list, the connection that it has is worth nothing any more. */
    free(list);
    list = mem_printf("client %s c\n", client);
    write_list(rig, list);
    for (int i = 0; ask_kind(&caller, LM__ENVELOPE__BODY_HELLO) != RESULT_DENIED; i++) {
        assert_true(i < 200);
        rig_sleep(0.05);
    }
    hang_up(&caller);
    free(list);
    free(address);
    free(number);
    free(secret);
    free(open);
    rig_destroy(&rig);
}

/* ---- clear words --------------------------------------------------------------------------------------- */

static void peers_say_what_is_wrong_with_their_keys(void **state)
{
    (void)state;
    rig_t *rig = rig_new();
    key_pair_t stranger;
    rig_use_keys(rig);
    assert_int_equal(key_files_make(rig->keys, "stranger", &stranger).code, RESULT_OK);
    rig_start_master(rig, 0.5);
    char *address = mem_printf("127.0.0.1:%d", rig->port), *open = scratch_path(rig->keys, "master.key");
    char *client = scratch_path(rig->keys, "client.secret"),
         *unknown = scratch_path(rig->keys, "stranger.secret");
    char *wrong = scratch_path(rig->keys, "stranger.key"), *cache = scratch_path(rig->folder, "cache");
    const struct {
        const char *key, *master;
        int code;
        const char *words;
    } cases[] = {{unknown, open, RESULT_DENIED, "the master does not accept the key"},
                 {client, wrong, RESULT_UNREACHABLE, "--master-key may be another master's"},
                 {client, open, RESULT_OK, "workers connected"}};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++) {
        pid_t process =
            rig_start_command(rig, (const char *[]){"status", "--master", address, "--timeout", "3", "--key",
                                                    cases[i].key, "--master-key", cases[i].master, NULL});
        assert_int_equal(rig_wait_exit(rig, process, 20), cases[i].code);
        if (!says(rig, process, cases[i].words)) fail_msg("%s", rig_output(rig, process));
    }
    pid_t process = rig_start_command(
        rig, (const char *[]){"status", "--master", address, "--timeout", "3", "--insecure", NULL});
    int code = rig_wait_exit(rig, process, 20);
    assert_true(code == RESULT_DENIED || code == RESULT_UNREACHABLE);
    assert_true(says(rig, process, "want"));
    pid_t worker = rig_start_program(
        rig, "lightmill-worker",
        (const char *[]){address, "--cache", cache, "--key", unknown, "--master-key", open, NULL});
    wait_until_says(rig, worker, "the master does not accept the key");
    kill(worker, SIGTERM);
    assert_int_equal(rig_wait_exit(rig, worker, 30), 0);
    free(address);
    free(open);
    free(client);
    free(unknown);
    free(wrong);
    free(cache);
    rig_destroy(&rig);
}

/* ---- the picture --------------------------------------------------------------------------------------- */

static void give_new_key(rig_t *rig, const char *name)
{
    key_pair_t pair;
    char *secret = mem_printf("%s/%s.secret", rig->keys, name),
         *open = mem_printf("%s/%s.key", rig->keys, name);
    char *fresh = mem_printf("%s/fresh.secret", rig->keys),
         *fresh_open = mem_printf("%s/fresh.key", rig->keys);
    assert_int_equal(key_files_make(rig->keys, "fresh", &pair).code, RESULT_OK);
    assert_int_equal(rename(fresh, secret), 0);
    assert_int_equal(rename(fresh_open, open), 0);
    free(secret);
    free(open);
    free(fresh);
    free(fresh_open);
}

static void keys_change_while_a_job_runs(void **state)
{
    (void)state;
    hash_t reference = rig_reference();
    rig_t *rig = rig_new();
    char worker[KEY_TEXT + 1], client[KEY_TEXT + 1], fresh[KEY_TEXT + 1];
    rig_use_keys(rig);
    open_key(rig, "worker", worker);
    open_key(rig, "client", client);
    rig_start_master(rig, 0.2);
    pid_t process = rig_start_worker(rig);
    job_settings_t settings = rig_settings();
    uint64_t job = rig_submit(rig, &settings);
    rig_wait_samples(rig, job, 1);

    /* The new key is let in, the worker's file changes, the old key is let out. */
    give_new_key(rig, "worker");
    open_key(rig, "worker", fresh);
    assert_string_not_equal(fresh, worker);
    char *both = mem_printf("client %s c\nworker %s old\nworker %s new\n", client, worker, fresh);
    char *one = mem_printf("client %s c\nworker %s new\n", client, fresh);
    write_list(rig, both);
    wait_until_says(rig, rig->master, "lets in 3 keys");
    rig_status_t before = rig_status(rig, job);
    assert_int_not_equal(before.state, JOB_DONE);
    write_list(rig, one);
    wait_until_says(rig, process, "is not on the master's list");
    rig_status_t after = rig_wait_job(rig, job);
    assert_int_equal(after.state, JOB_DONE);
    assert_true(after.samples_done == after.samples_total);
    assert_int_equal(after.batches_refused, 0);
    hash_t hash = rig_image_hash(rig, job);
    assert_true(hash_equal(&hash, &reference));
    char *joined = mem_printf("admitted a connection from 127.0.0.1: new, key %s", fresh);
    assert_true(says(rig, rig->master, joined));
    kill(process, SIGTERM);
    assert_int_equal(rig_wait_exit(rig, process, 30), 0);
    free(joined);
    free(both);
    free(one);
    rig_destroy(&rig);
}

static void the_commands_work_with_keys(void **state)
{
    (void)state;
    hash_t reference = rig_reference();
    rig_t *rig = rig_new();
    rig_use_keys(rig);
    rig_start_master(rig, 0.2);
    rig_start_worker(rig);
    rig_start_worker(rig);
    char *address = mem_printf("127.0.0.1:%d", rig->port), *image = scratch_path(rig->folder, "image.exr");
    char *secret = scratch_path(rig->keys, "client.secret"), *open = scratch_path(rig->keys, "master.key");
    assert_int_equal(
        rig_run(rig, (const char *[]){"submit", "scenes/seed-hidden", "--wait", "--quiet", "--resolution",
                                      "64x64", "--spp", RIG_SPP, "--seed", "7", "-o", image, "--master",
                                      address, "--key", secret, "--master-key", open, NULL}),
        0);
    hash_t hash = rig_file_hash(image);
    assert_true(hash_equal(&hash, &reference));
    wire_message_t message;
    assert_int_equal(remote_workers(rig->remote, &message).code, RESULT_OK);
    assert_int_equal(message.envelope->worker_list->n_workers, 2);
    assert_string_equal(message.envelope->worker_list->workers[0]->key, "farm"); /* as the list calls it */
    wire_free(&message);
    free(address);
    free(image);
    free(secret);
    free(open);
    rig_destroy(&rig);
}

/* ---- beginning ----------------------------------------------------------------------------------------- */

/* As docs/security.md tells it: a master for everybody to reach makes its key and says what to do. */
static void a_master_makes_its_key_and_says_what_to_do(void **state)
{
    (void)state;
    rig_t *rig = rig_new();
    char *data = scratch_path(rig->folder, "data"), *listen = mem_printf("0.0.0.0:%d", rig->port);
    char *address = mem_printf("127.0.0.1:%d", rig->port);
    char *mine = scratch_path(rig->folder, "mine"), *secret = scratch_path(mine, "client.secret");
    char *open = scratch_path(data, "keys/master.key"), *allow = scratch_path(data, "keys/allow");
    struct stat status;
    const char *const master[] = {"--listen", listen, "--data", data, NULL};
    pid_t process = rig_start_program(rig, "lightmill-master", master);
    wait_until_says(rig, process, "read again whenever it changes");
    char key[KEY_TEXT + 1];
    assert_int_equal(key_file_read_open(open, key).code, RESULT_OK);
    char *command = mem_printf("lightmill-worker ");
    char *argument = mem_printf("--master-key '%s'", key);
    assert_true(says(rig, process, command) && says(rig, process, argument));
    char *master_secret = scratch_path(data, "keys/master.secret");
    assert_int_equal(stat(master_secret, &status), 0);
    assert_int_equal(status.st_mode & 0777, 0600);

    pid_t keygen = rig_start_command(rig, (const char *[]){"keygen", "--out", mine, NULL});
    assert_int_equal(rig_wait_exit(rig, keygen, 20), 0);
    char *output = rig_output(rig, keygen), *line = strstr(output, "\nclient ");
    assert_non_null(line);
    line[1 + strcspn(line + 1, "\n")] = '\0';
    assert_non_null(strstr(line, " client@")); /* and the name of this machine */
    assert_int_equal(rig_run(rig, (const char *[]){"allow", line + 1, "--data", data, NULL}), 0);
    assert_int_equal(access(allow, R_OK), 0);
    keygen = rig_start_command(rig, (const char *[]){"keygen", "relay", "--out", mine, NULL});
    assert_int_equal(rig_wait_exit(rig, keygen, 20), 0);
    assert_true(says(rig, keygen, "worker ")); /* which a relay is to its master */
    wait_until_says(rig, process, "lets in 1 key");
    assert_int_equal(rig_run(rig, (const char *[]){"status", "--master", address, "--key", secret,
                                                   "--master-key", key, NULL}),
                     0);
    /* Until it is excluded. */
    const char *called = strrchr(line, ' ') + 1;
    assert_int_equal(rig_run(rig, (const char *[]){"exclude", called, "--data", data, NULL}), 0);
    int code = 0;
    for (double deadline = clock_now() + 20; code != RESULT_DENIED && clock_now() < deadline;) {
        rig_sleep(0.5); /* the master looks at its list once a second */
        code = rig_run(
            rig, (const char *[]){"status", "--master", address, "--key", secret, "--master-key", key, NULL});
    }
    assert_int_equal(code, RESULT_DENIED);
    assert_int_equal(rig_run(rig, (const char *[]){"allow", line + 1, "--data", data, NULL}), 0);
    /* The second time it has its key. */
    kill(process, SIGTERM);
    assert_int_equal(rig_wait_exit(rig, process, 30), 0);
    process = rig_start_program(rig, "lightmill-master", master);
    wait_until_says(rig, process, key);
    wait_until_says(rig, process, "lets in 1 key");
    assert_false(says(rig, process, "new key"));
    free(data);
    free(listen);
    free(address);
    free(mine);
    free(secret);
    free(open);
    free(allow);
    free(command);
    free(argument);
    free(master_secret);
    free(output);
    rig_destroy(&rig);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(nothing_without_a_listed_key),
        cmocka_unit_test(a_key_has_the_rights_that_the_list_gives_it),
        cmocka_unit_test(peers_say_what_is_wrong_with_their_keys),
        cmocka_unit_test(keys_change_while_a_job_runs),
        cmocka_unit_test(the_commands_work_with_keys),
        cmocka_unit_test(a_master_makes_its_key_and_says_what_to_do),
    };
    return cmocka_run_group_tests_name("a farm with keys", tests, NULL, NULL);
}
