/* dial: see dial.h.
 *
 * DESIGN. A CURVE connection that a master refuses just never becomes one, and a program that waits for an
 * answer would hang without a word. libzmq tells what happened to those who watch the socket. Three things
 * can be told apart: the master knows our key and refuses it (it says so, encrypted), the mechanisms differ
 * (one side uses keys, the other does not), or the connection breaks off in the handshake (the master's key
 * is not the one that we were given, or the mechanisms differ and the other side hung up first). The first
 * two are final, and libzmq does not dial again; the third may also be a master that is just ending, and is
 * tried again. */
#include "proto/wire/dial.h"

#include "common/address.h"
#include "proto/wire/wire.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include <zmq.h>

enum { BROKEN_ENOUGH = 2 /* handshakes that break off before they are held against the keys */ };

static const option_t rows[] = {
    OPTION(
        dial_options_t, key, "key", "FILE",
        "the own key, a .secret file that lightmill keygen made (default: $LIGHTMILL_KEY, the key itself, or "
        "$LIGHTMILL_KEY_FILE, or ~/.config/lightmill/ROLE.secret, where ROLE is worker or client)"),
    OPTION(dial_options_t, master_key, "master-key", "KEY",
           "the master's public key, or a file that holds it (default: $LIGHTMILL_MASTER_KEY, or "
           "$LIGHTMILL_MASTER_KEY_FILE, or ~/.config/lightmill/master.key)"),
    OPTION(dial_options_t, insecure, "insecure", NULL,
           "no keys, even to another machine; to loopback none are used unless given"),
};
const option_group_t dial_options =
    OPTION_GROUP("Keys, for a master on another machine (docs/security.md)", rows);

/* ---- finding keys -------------------------------------------------------------------------------------- */

static const char *environment(const char *name)
{
    const char *value = getenv(name);
    return value != NULL && value[0] != '\0' ? value : NULL;
}

/* ~/.config/lightmill/NAME.EXTENSION if there is such a file, else NULL. */
static char *default_file(const char *name, const char *extension)
{
    char *directory = key_default_directory();
    if (directory == NULL) return NULL;
    char *path = mem_printf("%s/%s.%s", directory, name, extension);
    free(directory);
    if (access(path, F_OK) == 0) return path;
    free(path);
    return NULL;
}

/* A key, or the path of a file, which may look like a key. */
static void take_master(dial_keys_t *keys, const char *text)
{
    if (key_valid(text) && access(text, F_OK) != 0)
        memcpy(keys->master, text, KEY_TEXT + 1);
    else
        keys->master_path = mem_strdup(text);
}

/* What was said explicitly, on the command line or in the environment. */
static result_t take_given(const dial_options_t *options, dial_keys_t *keys)
{
    const char *secret = environment("LIGHTMILL_KEY"), *file = environment("LIGHTMILL_KEY_FILE");
    const char *master = environment("LIGHTMILL_MASTER_KEY");
    const char *master_file = environment("LIGHTMILL_MASTER_KEY_FILE");
    if (options->key != NULL) {
        keys->own_path = mem_strdup(options->key);
    } else if (secret != NULL) {
        result_t result = key_pair_complete(secret, &keys->own);
        if (result.code != RESULT_OK)
            return result_fail(RESULT_USAGE,
                               "LIGHTMILL_KEY is no secret key; LIGHTMILL_KEY_FILE would name its file");
    } else if (file != NULL) {
        keys->own_path = mem_strdup(file);
    }
    if (options->master_key != NULL)
        take_master(keys, options->master_key);
    else if (master != NULL)
        take_master(keys, master);
    else if (master_file != NULL)
        keys->master_path = mem_strdup(master_file);
    return result_ok();
}

static bool has_own(const dial_keys_t *keys)
{
    return keys->own_path != NULL || keys->own.secret[0] != '\0';
}

static bool has_master(const dial_keys_t *keys)
{
    return keys->master_path != NULL || keys->master[0] != '\0';
}

static result_t missing_own(const dial_options_t *options, const char *host)
{
    return result_fail(
        RESULT_DENIED,
        "a key is needed for the master on %s: make one with \"lightmill keygen %s\", give the line "
        "that it prints to the master's list, and say --key FILE.secret; --insecure does without",
        host, options->role);
}

static result_t missing_master(const char *host)
{
    return result_fail(
        RESULT_DENIED,
        "the public key of the master on %s is needed: it prints the key when it starts and keeps it "
        "in DATA/keys/master.key; say --master-key KEY or --master-key FILE; --insecure does without",
        host);
}

/* Reads what is in files. */
static result_t read_files(dial_keys_t *keys)
{
    if (keys->own_path != NULL) TRY(key_file_read_secret(keys->own_path, &keys->own));
    if (keys->master_path != NULL) return key_file_read_open(keys->master_path, keys->master);
    return result_ok();
}

static result_t find(const dial_options_t *options, const char *host, dial_keys_t *keys)
{
    if (options->insecure) {
        if (options->key == NULL && options->master_key == NULL) return result_ok();
        return result_fail(RESULT_USAGE,
                           "--insecure means without keys: leave it out, or --key and --master-key");
    }
    TRY(take_given(options, keys));
    if (!has_own(keys) && !has_master(keys) && address_is_loopback(host)) return result_ok();
    if (!has_own(keys)) keys->own_path = default_file(options->role, "secret");
    if (!has_master(keys)) keys->master_path = default_file("master", "key");
    if (!has_own(keys)) return missing_own(options, host);
    if (!has_master(keys)) return missing_master(host);
    keys->used = true;
    TRY(read_files(keys));
    if (keys->own_path != NULL) key_file_check_mode(keys->own_path);
    return result_ok();
}

result_t dial_keys_find(const dial_options_t *options, const char *host, dial_keys_t *keys)
{
    *keys = (dial_keys_t){0};
    result_t result = find(options, host, keys);
    if (result.code != RESULT_OK) dial_keys_free(keys);
    return result;
}

void dial_keys_free(dial_keys_t *keys)
{
    key_pair_forget(&keys->own);
    free(keys->own_path);
    free(keys->master_path);
    *keys = (dial_keys_t){0};
}

result_t dial_find(const dial_options_t *options, const char *address, dial_keys_t *keys, char **endpoint)
{
    address_t parsed;
    *keys = (dial_keys_t){0};
    *endpoint = NULL;
    TRY(address_parse(address != NULL ? address : "127.0.0.1", WIRE_DEFAULT_PORT, &parsed));
    TRY(dial_keys_find(options, parsed.host, keys));
    *endpoint = address_endpoint(&parsed, parsed.port);
    return result_ok();
}

static result_t set_key(void *socket, int option, const char *key)
{
    if (zmq_setsockopt(socket, option, key, KEY_TEXT + 1) == 0) return result_ok();
    return result_fail(RESULT_IO, "cannot give a key to a socket: %s", zmq_strerror(errno));
}

result_t dial_keys_apply(dial_keys_t *keys, void *socket)
{
    if (keys == NULL || !keys->used) return result_ok();
    dial_keys_t fresh = *keys;
    result_t result = read_files(&fresh);
    if (result.code == RESULT_OK)
        *keys = fresh;
    else
        log_warning("%s; going on with the key that was read before", result.message);
    TRY(set_key(socket, ZMQ_CURVE_SERVERKEY, keys->master));
    TRY(set_key(socket, ZMQ_CURVE_PUBLICKEY, keys->own.open));
    return set_key(socket, ZMQ_CURVE_SECRETKEY, keys->own.secret);
}

/* ---- watching handshakes ------------------------------------------------------------------------------- */

static const int EVENTS = ZMQ_EVENT_HANDSHAKE_SUCCEEDED | ZMQ_EVENT_HANDSHAKE_FAILED_NO_DETAIL |
                          ZMQ_EVENT_HANDSHAKE_FAILED_PROTOCOL | ZMQ_EVENT_HANDSHAKE_FAILED_AUTH |
                          ZMQ_EVENT_DISCONNECTED;

result_t dial_watch_open(dial_watch_t *watch, void *context, void *socket, const dial_keys_t *keys)
{
    char endpoint[64];
    *watch = (dial_watch_t){0};
    if (keys != NULL && keys->used) memcpy(watch->key, keys->own.open, sizeof watch->key);
    snprintf(endpoint, sizeof endpoint, "inproc://dial-watch-%p", socket);
    if (zmq_socket_monitor(socket, endpoint, EVENTS) == 0) {
        watch->monitor = zmq_socket(context, ZMQ_PAIR);
        if (watch->monitor != NULL && zmq_connect(watch->monitor, endpoint) == 0) return result_ok();
    }
    result_t result = result_fail(RESULT_IO, "cannot watch a socket: %s", zmq_strerror(errno));
    dial_watch_close(watch, socket);
    return result;
}

void dial_watch_close(dial_watch_t *watch, void *socket)
{
    if (watch->monitor == NULL) return;
    zmq_socket_monitor(socket, NULL, 0);
    zmq_close(watch->monitor);
    watch->monitor = NULL;
}

static void deny(dial_watch_t *watch, result_t verdict)
{
    watch->denied = true;
    watch->verdict = verdict;
}

static void on_event(dial_watch_t *watch, uint16_t event)
{
    bool keys = watch->key[0] != '\0';
    switch (event) {
    case ZMQ_EVENT_HANDSHAKE_SUCCEEDED:
        watch->broken = 0;
        watch->up = true;
        watch->verdict = result_ok();
        break;
    case ZMQ_EVENT_DISCONNECTED:
        watch->lost += watch->up;
        watch->up = false;
        break;
    case ZMQ_EVENT_HANDSHAKE_FAILED_AUTH:
        deny(watch, result_fail(RESULT_DENIED, "the master does not accept the key %s: it is not on its list",
                                watch->key));
        break;
    case ZMQ_EVENT_HANDSHAKE_FAILED_PROTOCOL:
        deny(watch,
             keys ? result_fail(RESULT_DENIED, "the master uses no keys (or is none): --insecure "
                                               "speaks to it without")
                  : result_fail(
                        RESULT_DENIED,
                        "the master wants keys: say --key and --master-key, or dial it by its host's name "
                        "if they are in ~/.config/lightmill"));
        break;
    default:
        if (++watch->broken < BROKEN_ENOUGH) break;
        watch->verdict =
            keys ? result_fail(RESULT_UNREACHABLE,
                               "the connection breaks off when keys are compared: --master-key "
                               "may be another master's, or this master uses no keys")
                 : result_fail(
                       RESULT_UNREACHABLE,
                       "the connection breaks off at once: the master may want keys (--key, --master-key)");
    }
}

result_t dial_watch_poll(dial_watch_t *watch)
{
    while (watch->monitor != NULL) {
        struct {
            uint8_t event[2], value[4];
        } frame;
        uint16_t event;
        int size = zmq_recv(watch->monitor, &frame, sizeof frame, ZMQ_DONTWAIT);
        if (size < 0) break;
        if (size < (int)sizeof frame.event)
            continue; /* the second frame of an event, which names the endpoint */
        int more = 0;
        size_t option_size = sizeof more;
        zmq_getsockopt(watch->monitor, ZMQ_RCVMORE, &more, &option_size);
        if (!more) continue;
        memcpy(&event, frame.event, sizeof event);
        if (!watch->denied) on_event(watch, event);
    }
    return watch->verdict;
}
