/* gate: see gate.h.
 *
 * DESIGN. libzmq asks a ZAP handler (RFC 27) in the same context about every connection whose handshake has
 * shown a key. One thread answers, from the list in memory; it also looks at the list's file twice a second,
 * and reads it when it has changed and stayed the same from one look to the next, so that a file that an
 * editor is just writing is not taken for a list. Lines that are only added count at once: a key that is not
 * on the list makes the thread look too. A list with a mistake changes nothing: the one in force stays.
 *
 * A connection lives on when its key is taken out of the list: its peer is told so, and may dial again with
 * another key. So a right is not a property of a connection: the connection carries the key (its user id,
 * which wire_receive believes only on sockets with CURVE), and the servers ask at every message what the key
 * may do now. */
#include "proto/serve/gate.h"

#include "common/thread.h"
#include "common/wake.h"
#include "proto/serve/allow_list.h"
#include "proto/serve/complaint.h"
#include "proto/serve/handshakes.h"

#include <errno.h>
#include <fcntl.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static const char ZAP_ENDPOINT[] = "inproc://zeromq.zap.01";
static const char ZAP_DOMAIN[] = "lightmill";

enum {
    LOOK_MS = 500,        /* between looks at the list's file, */
    PATROL_MS = 200,      /* and at the connections */
    HANDSHAKE_MS = 10000, /* a connection that has not shown its key by then is closed */
    SOCKETS = 2,
    ZAP_FRAMES = 7,
    ZAP_FRAME_SIZE = 256, /* all that are longer are none of libzmq's */
    REQUEST_ID = 1,
    ADDRESS = 3,
    MECHANISM = 5,
    CREDENTIALS = 6, /* frames of a request */
    KEY_BYTES = 32
};

/* What tells one version of a file from another. */
typedef struct {
    bool exists;
    dev_t device;
    ino_t inode;
    off_t size;
    struct timespec time;
} file_mark_t;

struct gate {
    bool keys; /* false: everybody may do everything; there is no pair, list or zap */
    bool key_is_new;
    bool relay; /* what it guards is a relay */
    key_pair_t pair;
    char *key_path, *open_path, *allow_path;
    pthread_mutex_t lock; /* guards list */
    allow_list_t list;

    /* The thread's own, once it runs. */
    void *context, *zap;
    connections_t *connections[SOCKETS];
    handshakes_t *handshakes[SOCKETS];
    int sockets;
    file_mark_t read, seen; /* the file when it was last read, and at the last look */
    complaint_t refused, broken, ended;
    heard_t *heard; /* any thread's */

    pthread_t thread;
    bool started;
    atomic_bool stop, reload;
    int wake;
};

static const option_t rows[] = {
    OPTION(gate_options_t, key, "key", "FILE",
           "the master's secret key (default: DATA/keys/master.secret, which is made when other machines can "
           "reach the master); on loopback keys are used only if this is said"),
    OPTION(gate_options_t, allow, "allow", "FILE",
           "the list of the keys that are let in (default: DATA/keys/allow), lines of \"worker KEY NAME\", "
           "\"client KEY NAME\" or \"all KEY NAME\"; read again when it changes and on SIGHUP"),
    OPTION(gate_options_t, insecure, "insecure", NULL, "use no keys, whoever can reach the master"),
};
const option_group_t gate_options = OPTION_GROUP("Keys (docs/security.md)", rows);

/* ---- key and list -------------------------------------------------------------------------------------- */

static result_t load_key(gate_t *gate, const gate_options_t *options, const char *directory)
{
    gate->key_path =
        options->key != NULL ? mem_strdup(options->key) : mem_printf("%s/master.secret", directory);
    gate->open_path = mem_printf("%s/master.key", directory);
    gate->key_is_new = options->key == NULL && access(gate->key_path, F_OK) != 0;
    if (gate->key_is_new) return key_files_make(directory, "master", &gate->pair);
    TRY(key_file_read_secret(gate->key_path, &gate->pair));
    key_file_check_mode(gate->key_path);
    return result_ok();
}

/* The list that a new master begins with. */
static result_t make_list(const char *path)
{
    static const char text[] =
        "# Whom this master lets in. Read again whenever it changes; a key whose line goes has no rights any "
        "more.\n"
        "# lightmill keygen prints such lines:\n"
        "#\n"
        "#     worker KEY NAME     may work: take units of jobs, fetch their scenes, deliver\n"
        "#     client KEY NAME     may submit and control jobs, and fetch images\n"
        "#     all    KEY NAME     may do both\n";
    FILE *file = fopen(path, "wxe");
    if (file == NULL && errno == EEXIST) return result_ok();
    bool written = file != NULL && fputs(text, file) >= 0;
    if (file != NULL && fclose(file) != 0) written = false;
    return written ? result_ok() : result_fail(RESULT_IO, "cannot write %.300s: %s", path, strerror(errno));
}

static file_mark_t mark_of(const char *path)
{
    struct stat status;
    if (stat(path, &status) != 0) return (file_mark_t){0};
    return (file_mark_t){true, status.st_dev, status.st_ino, status.st_size, status.st_mtim};
}

static bool same_mark(const file_mark_t *a, const file_mark_t *b)
{
    return a->exists == b->exists && a->device == b->device && a->inode == b->inode && a->size == b->size &&
           a->time.tv_sec == b->time.tv_sec && a->time.tv_nsec == b->time.tv_nsec;
}

static void use_list(gate_t *gate, const allow_list_t *fresh)
{
    pthread_mutex_lock(&gate->lock);
    allow_list_t old = gate->list;
    gate->list = *fresh;
    pthread_mutex_unlock(&gate->lock);
    log_info("%s lets in %zu key%s%s", gate->allow_path, fresh->count, fresh->count == 1 ? "" : "s",
             fresh->count == 0 ? ": nobody can connect before it has a line for them" : "");
    allow_list_free(&old);
}

static result_t read_list(gate_t *gate)
{
    allow_list_t fresh;
    gate->read = gate->seen = mark_of(gate->allow_path);
    TRY(allow_list_read(gate->allow_path, &fresh));
    use_list(gate, &fresh);
    return result_ok();
}

static void read_list_again(gate_t *gate)
{
    result_t result = read_list(gate);
    if (result.code != RESULT_OK)
        log_error("THE LIST OF KEYS CANNOT BE USED, the one before it stays in force: %s", result.message);
}

/* Reads the list if its file has changed, and has not changed since the last look. */
static void look_at_list(gate_t *gate)
{
    file_mark_t now = mark_of(gate->allow_path);
    bool still = same_mark(&now, &gate->seen);
    gate->seen = now;
    if (still && !same_mark(&now, &gate->read)) read_list_again(gate);
}

/* Reads it at once if it has changed and takes nothing from anyone: somebody whose key is not known dials
 * just after its line was written. */
static void look_for_newcomers(gate_t *gate)
{
    allow_list_t fresh;
    file_mark_t now = mark_of(gate->allow_path);
    if (same_mark(&now, &gate->read) || allow_list_read(gate->allow_path, &fresh).code != RESULT_OK) return;
    if (!allow_list_holds(&fresh, &gate->list)) {
        allow_list_free(&fresh);
        return;
    }
    gate->read = gate->seen = now;
    use_list(gate, &fresh);
}

void gate_reload(gate_t *gate)
{
    if (gate == NULL || !gate->keys) return;
    atomic_store(&gate->reload, true);
    wake_up(gate->wake);
}

/* ---- setting up ---------------------------------------------------------------------------------------- */

static result_t open_zap(gate_t *gate)
{
    int linger = 0;
    if (!zmq_has("curve"))
        return result_fail(RESULT_IO, "this libzmq cannot encrypt: it was built without CURVE");
    gate->zap = zmq_socket(gate->context, ZMQ_REP);
    if (gate->zap != NULL) zmq_setsockopt(gate->zap, ZMQ_LINGER, &linger, sizeof linger);
    if (gate->zap != NULL && zmq_bind(gate->zap, ZAP_ENDPOINT) == 0) return result_ok();
    return result_fail(RESULT_IO, "cannot listen on %s: %s", ZAP_ENDPOINT, zmq_strerror(errno));
}

static result_t load_list(gate_t *gate, const gate_options_t *options, const char *directory)
{
    gate->allow_path =
        options->allow != NULL ? mem_strdup(options->allow) : mem_printf("%s/allow", directory);
    if (options->allow == NULL) {
        TRY(directory_make(directory, 0700));
        TRY(make_list(gate->allow_path));
    }
    return read_list(gate);
}

static result_t set_up(gate_t *gate, const gate_options_t *options, const char *data_dir)
{
    char *directory = mem_printf("%s/keys", data_dir);
    result_t result = load_key(gate, options, directory);
    if (result.code == RESULT_OK) result = load_list(gate, options, directory);
    free(directory);
    return result.code == RESULT_OK ? open_zap(gate) : result;
}

result_t gate_new(const gate_options_t *options, const char *data_dir, void *context, bool exposed,
                  gate_t **out)
{
    gate_t *gate = mem_zalloc(1, sizeof *gate);
    *out = gate;
    pthread_mutex_init(&gate->lock, NULL);
    gate->wake = -1;
    gate->heard = mem_zalloc(1, sizeof *gate->heard);
    gate->context = context;
    gate->relay = options->relay;
    bool wanted = options->key != NULL || options->allow != NULL;
    if (options->insecure && wanted)
        return result_fail(RESULT_USAGE, "--insecure means without keys: leave it out, or --key and --allow");
    gate->keys = wanted || (exposed && !options->insecure);
    TRY(wake_new(&gate->wake));
    return gate->keys ? set_up(gate, options, data_dir) : result_ok();
}

static result_t give_key(const gate_t *gate, void *socket)
{
    int on = 1;
    if (zmq_setsockopt(socket, ZMQ_CURVE_SERVER, &on, sizeof on) == 0 &&
        zmq_setsockopt(socket, ZMQ_CURVE_SECRETKEY, gate->pair.secret, KEY_TEXT + 1) == 0 &&
        zmq_setsockopt(socket, ZMQ_ZAP_DOMAIN, ZAP_DOMAIN, sizeof ZAP_DOMAIN - 1) == 0)
        return result_ok();
    return result_fail(RESULT_IO, "cannot give a key to a socket: %s", zmq_strerror(errno));
}

result_t gate_guard(gate_t *gate, void *socket, const char *name, const connection_limits_t *limits)
{
    int patience = HANDSHAKE_MS, at = gate->sockets;
    if (at == SOCKETS) return result_ok();
    if (gate->keys) TRY(give_key(gate, socket));
    if (zmq_setsockopt(socket, ZMQ_HANDSHAKE_IVL, &patience, sizeof patience) != 0)
        return result_fail(RESULT_IO, "cannot limit a socket's handshakes: %s", zmq_strerror(errno));
    gate->sockets++;
    gate->connections[at] = connections_new(name, limits, gate->heard);
    return handshakes_watch(gate->context, socket, name, gate->keys, gate->connections[at],
                            &gate->handshakes[at]);
}

/* ---- admitting connections ----------------------------------------------------------------------------- */

/* The frames of one request as text, cut where they are too long. */
typedef struct {
    char frames[ZAP_FRAMES][ZAP_FRAME_SIZE + 1];
    size_t sizes[ZAP_FRAMES];
    int count; /* may be more than there is room for */
} zap_request_t;

/* False when there is none. */
static bool receive_request(void *zap, zap_request_t *request)
{
    request->count = 0;
    for (int more = 1; more; request->count++) {
        zmq_msg_t frame;
        zmq_msg_init(&frame);
        if (zmq_msg_recv(&frame, zap, ZMQ_DONTWAIT) < 0) {
            zmq_msg_close(&frame);
            return false;
        }
        if (request->count < ZAP_FRAMES) {
            size_t size = zmq_msg_size(&frame) < ZAP_FRAME_SIZE ? zmq_msg_size(&frame) : ZAP_FRAME_SIZE;
            memcpy(request->frames[request->count], zmq_msg_data(&frame), size);
            request->frames[request->count][size] = '\0';
            request->sizes[request->count] = size;
        }
        more = zmq_msg_more(&frame);
        zmq_msg_close(&frame);
    }
    return true;
}

static void answer_request(void *zap, const zap_request_t *request, const char *status, const char *text,
                           const char *user)
{
    const char *frames[] = {"1.0", request->frames[REQUEST_ID], status, text, user, ""};
    for (size_t i = 0; i < ARRAY_LENGTH(frames); i++) {
        size_t size = i == 1 ? request->sizes[REQUEST_ID] : strlen(frames[i]);
        int flags = ZMQ_DONTWAIT | (i + 1 < ARRAY_LENGTH(frames) ? ZMQ_SNDMORE : 0);
        if (zmq_send(zap, frames[i], size, flags) < 0)
            log_debug("cannot answer libzmq: %s", zmq_strerror(errno));
    }
}

static unsigned rights_of(gate_t *gate, const char *key, char name[KEY_MAX_NAME + 1])
{
    pthread_mutex_lock(&gate->lock);
    const allow_entry_t *entry = allow_list_find(&gate->list, key);
    unsigned rights = entry != NULL ? entry->rights : 0;
    if (name != NULL) snprintf(name, KEY_MAX_NAME + 1, "%s", entry != NULL ? entry->name : "");
    pthread_mutex_unlock(&gate->lock);
    return rights;
}

static void judge(gate_t *gate, const zap_request_t *request)
{
    char key[KEY_TEXT + 1], name[KEY_MAX_NAME + 1], user[WIRE_USER_ID + 1];
    bool sound = request->count == ZAP_FRAMES && strcmp(request->frames[MECHANISM], "CURVE") == 0 &&
                 request->sizes[CREDENTIALS] == KEY_BYTES;
    if (!sound || zmq_z85_encode(key, (const uint8_t *)request->frames[CREDENTIALS], KEY_BYTES) == NULL) {
        answer_request(gate->zap, request, "500", "not understood", "");
        return;
    }
    unsigned rights = rights_of(gate, key, name);
    if (rights == 0) {
        look_for_newcomers(gate);
        rights = rights_of(gate, key, name);
    }
    if (rights != 0) {
        log_debug("admitted a connection from %s: %s, key %s", request->frames[ADDRESS], name, key);
        wire_user_id(rights, key, user);
        answer_request(gate->zap, request, "200", "OK", user);
        return;
    }
    if (complaint_allowed(&gate->refused, clock_now()))
        log_warning("refused a connection from %s: the key %s is not in %s", request->frames[ADDRESS], key,
                    gate->allow_path);
    answer_request(gate->zap, request, "400", "this key is not on the list", "");
}

static void answer_all(gate_t *gate)
{
    static const int TURN = 256; /* requests, before the other duties have theirs */
    zap_request_t request;
    for (int i = 0; i < TURN && receive_request(gate->zap, &request); i++) {
        if (request.count > REQUEST_ID)
            judge(gate, &request);
        else
            zmq_send(gate->zap, "", 0, ZMQ_DONTWAIT); /* a REP socket has to answer before it goes on */
    }
}

/* ---- the thread ---------------------------------------------------------------------------------------- */

static void wait_events(gate_t *gate)
{
    zmq_pollitem_t items[2 + SOCKETS] = {{.fd = gate->wake, .events = ZMQ_POLLIN}};
    int count = 1;
    for (int i = 0; i < gate->sockets; i++)
        items[count++] =
            (zmq_pollitem_t){.socket = handshakes_socket(gate->handshakes[i]), .events = ZMQ_POLLIN};
    if (gate->keys) items[count++] = (zmq_pollitem_t){.socket = gate->zap, .events = ZMQ_POLLIN};
    zmq_poll(items, count, PATROL_MS);
    if (items[0].revents != 0) wake_clear(gate->wake);
}

static void *gate_run(void *argument)
{
    gate_t *gate = argument;
    double next_look = 0, next_patrol = 0;
    while (!atomic_load(&gate->stop)) {
        wait_events(gate);
        if (gate->keys) answer_all(gate);
        for (int i = 0; i < gate->sockets; i++) handshakes_report(gate->handshakes[i], &gate->broken);
        if (clock_now() >= next_patrol) {
            next_patrol = clock_now() + 1e-3 * PATROL_MS;
            for (int i = 0; i < gate->sockets; i++)
                connections_patrol(gate->connections[i], clock_now(), &gate->ended);
        }
        if (!gate->keys) continue;
        if (atomic_exchange(&gate->reload, false)) read_list_again(gate);
        if (clock_now() < next_look) continue;
        next_look = clock_now() + 1e-3 * LOOK_MS;
        look_at_list(gate);
    }
    return NULL;
}

/* To stdout: it is meant to be read and copied, not to be logged. */
static void introduce(const gate_t *gate, const char *host, int port)
{
    const char *who = gate->relay ? "relay" : "master", *key = gate->pair.open;
    printf("This %s has a new key. %s its public half,\n\n"
           "    %s\n\n"
           "which is also in %s.\n\n"
           "A worker's machine gets a key of its own, and joins with it:\n\n"
           "    lightmill keygen worker\n"
           "    lightmill-worker %s:%d --master-key '%s'\n\n",
           who, gate->relay ? "Workers need" : "Workers and clients need", key, gate->open_path, host, port,
           key);
    if (!gate->relay)
        printf("A client's machine likewise:\n\n"
               "    lightmill keygen client\n"
               "    lightmill status --master %s:%d --master-key '%s'\n\n",
               host, port, key);
    printf("keygen prints a line for the list of the keys that this %s lets in,\n\n"
           "    %s\n\n"
           "which is read again whenever it changes.\n",
           who, gate->allow_path);
    fflush(stdout);
}

static void say_key(const gate_t *gate, const char *host, int port)
{
    char name[256] = "";
    bool any = strcmp(host, "*") == 0 || strcmp(host, "0.0.0.0") == 0 || strcmp(host, "[::]") == 0;
    if (any && gethostname(name, sizeof name - 1) == 0 && name[0] != '\0') host = name;
    log_info("this %s's public key is %s", gate->relay ? "relay" : "master", gate->pair.open);
    if (gate->key_is_new) introduce(gate, host, port);
}

result_t gate_start(gate_t *gate, const char *host, int port)
{
    if (gate->keys) say_key(gate, host, port);
    if (!gate->keys && gate->sockets == 0) return result_ok(); /* all is in this process */
    TRY(thread_start(&gate->thread, "lm-gate", gate_run, gate));
    gate->started = true;
    return result_ok();
}

void gate_stop(gate_t **out)
{
    gate_t *gate = *out;
    if (gate == NULL) return;
    atomic_store(&gate->stop, true);
    wake_up(gate->wake);
    if (gate->started) pthread_join(gate->thread, NULL);
    for (int i = 0; i < gate->sockets; i++) {
        handshakes_destroy(&gate->handshakes[i]);
        connections_destroy(&gate->connections[i]);
    }
    free(gate->heard);
    if (gate->zap != NULL) zmq_close(gate->zap);
    wake_close(gate->wake);
    key_pair_forget(&gate->pair);
    allow_list_free(&gate->list);
    pthread_mutex_destroy(&gate->lock);
    free(gate->key_path);
    free(gate->open_path);
    free(gate->allow_path);
    free(gate);
    *out = NULL;
}

/* ---- messages ------------------------------------------------------------------------------------------ */

result_t gate_check(gate_t *gate, wire_message_t *message, unsigned needed)
{
    if (gate != NULL && gate->keys) message->rights = rights_of(gate, message->key, NULL);
    if (message->rights == 0)
        return result_fail(RESULT_DENIED, "the key %s is not on the master's list", message->key);
    if (needed == 0 || (message->rights & needed) != 0) return result_ok();
    return result_fail(RESULT_DENIED,
                       "the key %s %s, but not what this message asks for: that needs a key that %s",
                       message->key, wire_rights_name(message->rights), wire_rights_name(needed));
}

void gate_heard(gate_t *gate, int connection)
{
    if (gate == NULL || connection < 0 || connection >= CONNECTIONS_MAX) return;
    atomic_fetch_add(&gate->heard->messages[connection], 1);
}

void gate_expect(gate_t *gate, int connection, uint64_t bytes)
{
    if (gate == NULL || connection < 0 || connection >= CONNECTIONS_MAX) return;
    atomic_store(&gate->heard->expected[connection], bytes);
}

void gate_key_name(gate_t *gate, const char *key, char name[KEY_MAX_NAME + 1])
{
    name[0] = '\0';
    if (gate != NULL && gate->keys) rights_of(gate, key, name);
}

bool gate_find_key(gate_t *gate, const char *name, char key[KEY_TEXT + 1])
{
    bool found = false;
    if (gate == NULL || !gate->keys) return false;
    pthread_mutex_lock(&gate->lock);
    for (size_t i = 0; i < gate->list.count && !found; i++) {
        found = strcmp(gate->list.entries[i].name, name) == 0;
        if (found) memcpy(key, gate->list.entries[i].key, KEY_TEXT + 1);
    }
    pthread_mutex_unlock(&gate->lock);
    return found;
}
