/* Tests of keys and of who is let in: key files, lists of keys, where a peer finds its keys, limits of
 * messages, and user ids that peers give themselves. */
#include "proto/serve/allow_list.h"
#include "proto/serve/rate_limit.h"
#include "proto/wire/dial.h"
#include "proto/wire/wire.h"
#include "tests/scratch.h"

#include <arpa/inet.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

/* The example of RFC 32 (Z85): eight bytes. */
static const char SHORT[] = "HelloWorld";

static int make_folder(void **state)
{
    *state = scratch_new();
    return 0;
}

static int remove_folder(void **state)
{
    scratch_destroy((char **)state);
    return 0;
}

/* ---- keys ---------------------------------------------------------------------------------------------- */

static void keys_are_checked(void **state)
{
    (void)state;
    key_pair_t pair, again;
    assert_int_equal(key_pair_new(&pair).code, RESULT_OK);
    assert_true(key_valid(pair.open) && key_valid(pair.secret));
    assert_int_equal(key_pair_complete(pair.secret, &again).code, RESULT_OK);
    assert_string_equal(again.open, pair.open);
    char text[KEY_TEXT + 2];
    snprintf(text, sizeof text, "%s", pair.open);
    text[7] = '~'; /* not of Z85 */
    assert_false(key_valid(text));
    text[7] = '\xe9';
    assert_false(key_valid(text));
    memcpy(text, "#####", 5); /* more than 32 bits */
    assert_false(key_valid(text));
    assert_false(key_valid(""));
    assert_false(key_valid(SHORT));
    snprintf(text, sizeof text, "%s0", pair.open);
    assert_false(key_valid(text));
    assert_int_not_equal(key_pair_complete(text, &again).code, RESULT_OK);
    key_pair_forget(&pair);
    assert_int_equal(strlen(pair.secret), 0);
}

static void key_files_are_never_written_over(void **state)
{
    char *folder = scratch_path(*state, "a/b"), *secret = scratch_path(folder, "me.secret");
    char *open = scratch_path(folder, "me.key");
    key_pair_t pair, read;
    char key[KEY_TEXT + 1];
    struct stat status;
    assert_int_equal(key_files_make(folder, "me", &pair).code, RESULT_OK);
    assert_int_equal(stat(secret, &status), 0);
    assert_int_equal(status.st_mode & 0777, 0600);
    assert_int_equal(key_file_read_secret(secret, &read).code, RESULT_OK);
    assert_memory_equal(&read, &pair, sizeof pair);
    assert_int_equal(key_file_read_open(open, key).code, RESULT_OK);
    assert_string_equal(key, pair.open);
    assert_int_equal(key_file_read_open(secret, key).code, RESULT_OK);
    assert_string_equal(key, pair.open);
    assert_int_equal(key_file_read_secret(open, &read).code, RESULT_INPUT);

    assert_int_equal(key_files_make(folder, "me", &read).code, RESULT_INPUT);
    unlink(open);
    assert_int_equal(key_files_make(folder, "me", &read).code, RESULT_INPUT);
    assert_int_equal(access(open, F_OK), -1);
    assert_int_equal(key_file_read_secret(secret, &read).code, RESULT_OK);
    assert_string_equal(read.secret, pair.secret);
    const char *const bad[] = {"", "a/b", "../x", ".hidden", "-x", "a b"};
    for (size_t i = 0; i < ARRAY_LENGTH(bad); i++)
        assert_int_equal(key_files_make(folder, bad[i], &read).code, RESULT_USAGE);
    free(folder);
    free(secret);
    free(open);
}

static result_t parse_key_file(const char *text, key_pair_t *pair)
{
    return key_file_parse(text, strlen(text), "FILE", pair);
}

static void key_files_say_what_is_wrong(void **state)
{
    (void)state;
    key_pair_t pair, other, read;
    key_pair_new(&pair);
    key_pair_new(&other);
    char *text = mem_printf("# x\r\n\n  secret   %s  \r\n", pair.secret);
    assert_int_equal(parse_key_file(text, &read).code, RESULT_OK);
    assert_string_equal(read.open, pair.open);
    free(text);
    assert_int_equal(parse_key_file(pair.open, &read).code, RESULT_OK);
    assert_string_equal(read.open, pair.open);
    assert_int_equal(strlen(read.secret), 0);

    const struct {
        const char *format, *expected;
    } wrong[] = {{"public %s\npublic %s\n", "FILE:2: a second public key"},
                 {"# nothing\n", "FILE: there is no key"},
                 {"", "FILE: there is no key"},
                 {"\n\nprivate %s\n", "FILE:3: expected"},
                 {"public %s x\n", "FILE:1: a key has 40"},
                 {"secret short\n", "FILE:1: a key has 40"},
                 {"public\n", "FILE:1: a key has 40"},
                 {"\x01\n", "FILE:1: a control character"}};
    for (size_t i = 0; i < ARRAY_LENGTH(wrong); i++) {
        text = mem_printf(wrong[i].format, pair.open, pair.open); /* those that name no key ignore them */
        result_t result = parse_key_file(text, &read);
        assert_int_equal(result.code, RESULT_INPUT);
        if (strncmp(result.message, wrong[i].expected, strlen(wrong[i].expected)) != 0)
            fail_msg("%s, not %s", result.message, wrong[i].expected);
        free(text);
    }
    text = mem_printf("public %s\nsecret %s\n", other.open, pair.secret);
    result_t result = parse_key_file(text, &read);
    assert_non_null(strstr(result.message, "does not belong"));
    assert_int_equal(strlen(read.secret), 0);
    free(text);
    text = mem_alloc(KEY_MAX_LINE + 10);
    memset(text, 'x', KEY_MAX_LINE + 9);
    text[KEY_MAX_LINE + 9] = '\0';
    assert_non_null(strstr(parse_key_file(text, &read).message, "FILE:1: a line of"));
    free(text);
}

static char *check_mode(const char *folder, const char *path, mode_t mode)
{
    chmod(path, mode);
    scratch_capture_t capture = scratch_capture(folder, 2);
    key_file_check_mode(path);
    return scratch_uncapture(&capture);
}

static void secrets_that_others_can_read_are_worth_a_warning(void **state)
{
    key_pair_t pair;
    assert_int_equal(key_files_make(*state, "me", &pair).code, RESULT_OK);
    char *path = scratch_path(*state, "me.secret");
    char *quiet = check_mode(*state, path, 0600), *quiet_too = check_mode(*state, path, 0440);
    char *readable = check_mode(*state, path, 0644), *writable = check_mode(*state, path, 0660);
    assert_string_equal(quiet, "");
    assert_string_equal(quiet_too, "");
    assert_non_null(strstr(readable, "can read it"));
    assert_non_null(strstr(writable, "can change it"));
    free(quiet);
    free(quiet_too);
    free(readable);
    free(writable);
    free(path);
}

/* ---- lists --------------------------------------------------------------------------------------------- */

static result_t parse_list(const char *text, allow_list_t *list)
{
    return allow_list_parse(text, strlen(text), "LIST", list);
}

static void lists_give_rights(void **state)
{
    (void)state;
    key_pair_t keys[3];
    allow_list_t list;
    for (int i = 0; i < 3; i++) key_pair_new(&keys[i]);
    char *text = mem_printf("# the farm\n\nworker %s  render node 7 # in the cellar\n"
                            "\tclient\t%s\n"
                            "all %s tower",
                            keys[0].open, keys[1].open, keys[2].open);
    assert_int_equal(parse_list(text, &list).code, RESULT_OK);
    assert_int_equal(list.count, 3);
    const allow_entry_t *entry = allow_list_find(&list, keys[0].open);
    assert_non_null(entry);
    assert_int_equal(entry->rights, RIGHT_WORK);
    assert_string_equal(entry->name, "render node 7");
    entry = allow_list_find(&list, keys[1].open);
    assert_int_equal(entry->rights, RIGHT_CLIENT);
    assert_string_equal(entry->name, "");
    assert_int_equal(allow_list_find(&list, keys[2].open)->rights, RIGHTS_ALL);
    assert_null(allow_list_find(&list, keys[2].secret));
    assert_null(allow_list_find(&list, ""));
    allow_list_free(&list);
    free(text);
    assert_int_equal(parse_list("", &list).code, RESULT_OK);
    assert_null(allow_list_find(&list, keys[0].open));
}

static void lists_say_which_line_is_wrong(void **state)
{
    (void)state;
    key_pair_t key;
    allow_list_t list;
    key_pair_new(&key);
    const struct {
        const char *format, *expected;
    } wrong[] = {
        {"\nboss %s x\n", "LIST:2: a line begins with"},
        {"worker %.39s x\n", "LIST:1: after the right"},
        {"worker\n", "LIST:1: after the right"},
        {"%s worker\n", "LIST:1: a line begins with"},
        {"worker %s a\n# more\nclient %s b\n", "LIST:3: the key of line 1"},
        {"worker %s 0123456789012345678901234567890123456789012345678901234567890123\n", "LIST:1: a name"}};
    for (size_t i = 0; i < ARRAY_LENGTH(wrong); i++) {
        char *text = mem_printf(wrong[i].format, key.open, key.open);
        result_t result = parse_list(text, &list);
        assert_int_equal(result.code, RESULT_INPUT);
        if (strncmp(result.message, wrong[i].expected, strlen(wrong[i].expected)) != 0)
            fail_msg("%s, not %s", result.message, wrong[i].expected);
        assert_true(list.count == 0 && list.entries == NULL);
        free(text);
    }
}

/* ---- where a peer finds its keys ------------------------------------------------------------------------
 */

static void clear_environment(const char *folder)
{
    unsetenv("LIGHTMILL_KEY");
    unsetenv("LIGHTMILL_KEY_FILE");
    unsetenv("LIGHTMILL_MASTER_KEY");
    unsetenv("LIGHTMILL_MASTER_KEY_FILE");
    setenv("XDG_CONFIG_HOME", folder, 1);
}

static void expect_denied(const dial_options_t *options, const char *host, const char *cure)
{
    dial_keys_t keys;
    result_t result = dial_keys_find(options, host, &keys);
    assert_int_equal(result.code, RESULT_DENIED);
    assert_non_null(strstr(result.message, cure));
    assert_false(keys.used);
}

static void peers_find_their_keys(void **state)
{
    char *folder = *state, *config = scratch_path(folder, "lightmill");
    key_pair_t mine, master;
    dial_keys_t keys;
    dial_options_t options = {.role = "client"};
    clear_environment(folder);
    assert_int_equal(dial_keys_find(&options, "127.0.0.1", &keys).code, RESULT_OK);
    assert_false(keys.used);
    expect_denied(&options, "10.0.0.1", "lightmill keygen client");
    assert_int_equal(key_files_make(config, "client", &mine).code, RESULT_OK);
    expect_denied(&options, "farm", "--master-key");
    assert_int_equal(key_files_make(config, "master", &master).code, RESULT_OK);

    /* From the folder, but not to loopback. */
    assert_int_equal(dial_keys_find(&options, "farm", &keys).code, RESULT_OK);
    assert_true(keys.used);
    assert_string_equal(keys.own.secret, mine.secret);
    assert_string_equal(keys.master, master.open);
    dial_keys_free(&keys);
    assert_int_equal(dial_keys_find(&options, "localhost", &keys).code, RESULT_OK);
    assert_false(keys.used);

    /* What is given is used everywhere; the rest is completed. */
    options.master_key = mine.open;
    assert_int_equal(dial_keys_find(&options, "127.0.0.1", &keys).code, RESULT_OK);
    assert_true(keys.used);
    assert_string_equal(keys.master, mine.open);
    assert_string_equal(keys.own.open, mine.open);
    dial_keys_free(&keys);
    options.master_key = NULL;
    setenv("LIGHTMILL_KEY", master.secret, 1);
    assert_int_equal(dial_keys_find(&options, "127.0.0.1", &keys).code, RESULT_OK);
    assert_string_equal(keys.own.open, master.open);
    dial_keys_free(&keys);
    setenv("LIGHTMILL_KEY", "/run/secrets/key", 1);
    assert_int_equal(dial_keys_find(&options, "127.0.0.1", &keys).code, RESULT_USAGE);
    unsetenv("LIGHTMILL_KEY");
    setenv("LIGHTMILL_KEY_FILE", "/nowhere/key", 1);
    result_t result = dial_keys_find(&options, "127.0.0.1", &keys);
    assert_int_equal(result.code, RESULT_INPUT);
    assert_non_null(strstr(result.message, "/nowhere/key"));

    options.insecure = true;
    assert_int_equal(dial_keys_find(&options, "farm", &keys).code, RESULT_OK);
    assert_false(keys.used);
    options.key = "x.secret";
    assert_int_equal(dial_keys_find(&options, "farm", &keys).code, RESULT_USAGE);
    clear_environment(folder);
    free(config);
}

/* A path of 40 characters that a key may have, too: from within the folder, whose own name may be long. */
static void a_file_that_is_called_like_a_key_is_a_file(void **state)
{
    static const char name[] = "a-name-that-fills-it-up-to-the-limit",
                      path[] = "a-name-that-fills-it-up-to-the-limit.key";
    char *folder = *state;
    key_pair_t master;
    dial_keys_t keys;
    clear_environment(folder);
    int before = open(".", O_RDONLY | O_DIRECTORY);
    assert_int_equal(chdir(folder), 0);
    assert_true(key_valid(path));
    assert_int_equal(key_files_make(".", name, &master).code, RESULT_OK);
    dial_options_t options = {
        .role = "worker", .key = "a-name-that-fills-it-up-to-the-limit.secret", .master_key = path};
    assert_int_equal(dial_keys_find(&options, "farm", &keys).code, RESULT_OK);
    assert_string_equal(keys.master, master.open);
    dial_keys_free(&keys);
    assert_int_equal(fchdir(before), 0);
    close(before);
}

static void keys_are_read_again(void **state)
{
    char *folder = *state, *path = scratch_path(folder, "me.secret"), *open = scratch_path(folder, "me.key");
    key_pair_t first, second, master;
    dial_keys_t keys;
    char used[KEY_TEXT + 1];
    size_t size = sizeof used;
    clear_environment(folder);
    key_files_make(folder, "me", &first);
    key_pair_new(&master);
    dial_options_t options = {.role = "worker", .key = path, .master_key = master.open};
    assert_int_equal(dial_keys_find(&options, "farm", &keys).code, RESULT_OK);
    unlink(path);
    unlink(open);
    key_files_make(folder, "me", &second);
    void *context = zmq_ctx_new(), *socket = zmq_socket(context, ZMQ_DEALER);
    assert_int_equal(dial_keys_apply(&keys, socket).code, RESULT_OK);
    assert_int_equal(zmq_getsockopt(socket, ZMQ_CURVE_PUBLICKEY, used, &size), 0);
    assert_string_equal(used, second.open);
    unlink(path); /* gone: the last one is used */
    assert_int_equal(dial_keys_apply(&keys, socket).code, RESULT_OK);
    assert_int_equal(zmq_getsockopt(socket, ZMQ_CURVE_PUBLICKEY, used, &size), 0);
    assert_string_equal(used, second.open);
    zmq_close(socket);
    zmq_ctx_term(context);
    dial_keys_free(&keys);
    free(path);
    free(open);
}

/* ---- limits -------------------------------------------------------------------------------------------- */

static rate_verdict_t take(rate_limit_t *limit, double now, const char *name)
{
    return rate_limit_take(limit, now, name, strlen(name), 1);
}

static void peers_have_limits(void **state)
{
    (void)state;
    rate_limit_t *limit = rate_limit_new(10, 20, 64);
    for (int i = 0; i < 20; i++) assert_int_equal(take(limit, 5, "a"), RATE_PASS);
    assert_int_equal(take(limit, 5, "a"), RATE_TELL);
    for (int i = 0; i < 100; i++) assert_int_equal(take(limit, 5, "a"), RATE_DROP);
    assert_int_equal(take(limit, 5, "b"), RATE_PASS);
    assert_int_equal(take(limit, 5.11, "a"), RATE_PASS); /* one more token, and no second telling */
    assert_int_equal(take(limit, 5.11, "a"), RATE_DROP);
    for (int i = 0; i < 16; i++) assert_int_equal(take(limit, 6.75, "a"), RATE_PASS);
    assert_int_equal(take(limit, 6.75, "a"), RATE_TELL);
    for (int i = 0; i < 20; i++) assert_int_equal(take(limit, 1000, "a"), RATE_PASS);
    assert_int_equal(take(limit, 1000, "a"), RATE_TELL);
    assert_int_equal(rate_limit_take(limit, 1000, "c", 1, 15), RATE_PASS);
    assert_int_equal(rate_limit_take(limit, 1000, "c", 1, 6), RATE_TELL);
    assert_int_equal(rate_limit_take(limit, 1000, "c", 1, 5), RATE_PASS);
    rate_limit_destroy(&limit);
}

static void a_flood_of_names_does_not_empty_the_buckets_of_others(void **state)
{
    (void)state;
    rate_limit_t *limit = rate_limit_new(100, 10, 256);
    char name[32];
    double now = 1;
    for (int i = 0; i < 20000; i++, now += 1e-4) { /* 10000 new names a second, each busy for 10 ms */
        snprintf(name, sizeof name, "flood %d", i);
        take(limit, now, name);
        if (i % 500 == 0) assert_int_equal(take(limit, now, "steady"), RATE_PASS); /* 20 a second */
    }
    /* 256 buckets and 32 shared ones give 10 each and then 100 a second for two seconds, whatever the names.
     */
    int passed = 0;
    for (int i = 0; i < 400000; i++, now += 5e-6) {
        snprintf(name, sizeof name, "flood %d", i % 3000);
        passed += take(limit, now, name) == RATE_PASS;
    }
    assert_true(passed <= 288 * 210);
    rate_limit_destroy(&limit);
}

/* ---- user ids ------------------------------------------------------------------------------------------ */

static void put_property(uint8_t **out, const char *name, const char *value)
{
    size_t name_size = strlen(name), size = strlen(value);
    *(*out)++ = (uint8_t)name_size;
    memcpy(*out, name, name_size);
    *out += name_size;
    memcpy(*out, (uint8_t[]){0, 0, 0, (uint8_t)size}, 4);
    memcpy(*out + 4, value, size);
    *out += 4 + size;
}

/* A ZMTP 3.0 connection by hand, whose READY claims a user id; then one message of one frame. */
static int connect_forger(int port, const char *user_id)
{
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_port = htons((uint16_t)port)};
    uint8_t greeting[64] = {0xff, 0, 0, 0, 0, 0, 0, 0, 1, 0x7f, 3, 0, 'N', 'U', 'L', 'L'};
    uint8_t answer[64], ready[256], *end = ready + 2;
    int file = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    assert_int_equal(connect(file, (struct sockaddr *)&address, sizeof address), 0);
    assert_int_equal(send(file, greeting, sizeof greeting, 0), sizeof greeting);
    assert_int_equal(recv(file, answer, sizeof answer, MSG_WAITALL), sizeof answer);
    memcpy(end, "\5READY", 6);
    end += 6;
    put_property(&end, "Socket-Type", "DEALER");
    put_property(&end, "Identity", "forger");
    put_property(&end, "User-Id", user_id);
    put_property(&end, "Peer-Address", "192.0.2.1");
    ready[0] = 4; /* a short command */
    ready[1] = (uint8_t)(end - ready - 2);
    assert_int_equal(send(file, ready, (size_t)(end - ready), 0), end - ready);
    assert_int_equal(send(file, "\0\1x", 3, 0), 3);
    return file;
}

static void user_ids_of_peers_are_not_believed(void **state)
{
    (void)state;
    void *context = zmq_ctx_new(), *router;
    char endpoint[100], id[WIRE_USER_ID + 1];
    size_t size = sizeof endpoint;
    key_pair_t pair;
    wire_message_t message;
    bool received;
    key_pair_new(&pair);
    wire_user_id(RIGHT_CLIENT, pair.open, id);
    assert_int_equal(strlen(id), WIRE_USER_ID);
    assert_int_equal(wire_socket(context, ZMQ_ROUTER, &router).code, RESULT_OK);
    assert_int_equal(zmq_bind(router, "tcp://127.0.0.1:*"), 0);
    assert_int_equal(zmq_getsockopt(router, ZMQ_LAST_ENDPOINT, endpoint, &size), 0);
    int file = connect_forger(atoi(strrchr(endpoint, ':') + 1), id);
    zmq_pollitem_t item = {.socket = router, .events = ZMQ_POLLIN};
    assert_int_equal(zmq_poll(&item, 1, 5000), 1);
    assert_int_equal(wire_receive(router, true, &message, &received).code, RESULT_PROTOCOL);
    assert_int_equal(message.identity_size, strlen("forger"));
    assert_int_equal(message.rights, RIGHTS_ALL);
    assert_string_equal(message.key, "");
    assert_string_equal(message.address, "127.0.0.1");

    /* libzmq does hand on what the peer claims. */
    zmq_msg_t frame;
    assert_int_equal(send(file, "\0\1x", 3, 0), 3);
    assert_int_equal(zmq_poll(&item, 1, 5000), 1);
    zmq_msg_init(&frame);
    assert_true(zmq_msg_recv(&frame, router, 0) >= 0 && zmq_msg_recv(&frame, router, 0) >= 0);
    assert_string_equal(zmq_msg_gets(&frame, "User-Id"), id);
    zmq_msg_close(&frame);
    close(file);
    zmq_close(router);
    zmq_ctx_term(context);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(keys_are_checked),
        cmocka_unit_test_setup_teardown(key_files_are_never_written_over, make_folder, remove_folder),
        cmocka_unit_test(key_files_say_what_is_wrong),
        cmocka_unit_test_setup_teardown(secrets_that_others_can_read_are_worth_a_warning, make_folder,
                                        remove_folder),
        cmocka_unit_test(lists_give_rights),
        cmocka_unit_test(lists_say_which_line_is_wrong),
        cmocka_unit_test_setup_teardown(peers_find_their_keys, make_folder, remove_folder),
        cmocka_unit_test_setup_teardown(a_file_that_is_called_like_a_key_is_a_file, make_folder,
                                        remove_folder),
        cmocka_unit_test_setup_teardown(keys_are_read_again, make_folder, remove_folder),
        cmocka_unit_test(peers_have_limits),
        cmocka_unit_test(a_flood_of_names_does_not_empty_the_buckets_of_others),
        cmocka_unit_test(user_ids_of_peers_are_not_believed),
    };
    return cmocka_run_group_tests_name("keys", tests, NULL, NULL);
}
