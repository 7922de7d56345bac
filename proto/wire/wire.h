/* wire: messages on ZeroMQ sockets, and the hard limits on everything that a peer sends.
 *
 * A message is a header frame (the bytes "LMIL", a version byte, a checksum, then a protobuf Envelope) and
 * payload frames, at most one for each sum of a batch. A socket of the master is a ROUTER, a peer's is a
 * DEALER; on a ROUTER the identity frame comes first. Whatever arrives is checked against the limits before
 * anything is allocated for it; a message that breaks them is an error value, never an abort, and the socket
 * can go on being used.
 */
#ifndef LIGHTMILL_WIRE_H
#define LIGHTMILL_WIRE_H

#include "proto/wire/keys.h"
#include "proto/wire/lightmill.pb-c.h"
#include "proto/wire/payload.h"

enum {
    WIRE_VERSION = 8,
    WIRE_DEFAULT_PORT = 7420,         /* control; bulk is the next one */
    WIRE_MAX_HEADER = 1 << 20,        /* bytes of a header frame, preamble included */
    WIRE_MAX_CONTROL_FRAME = 1 << 20, /* control messages have no payloads */
    WIRE_MAX_CONTROL_ASKED = 1 << 14, /* those to a master; its answers may be lists */
    WIRE_MAX_DECODED = 16 << 20,      /* bytes that decoding one header may allocate */
    WIRE_MAX_PAYLOADS = BATCH_PAYLOADS,
    WIRE_MAX_UNITS = 1 << 14, /* units in an assignment or a batch */
    WIRE_MAX_STRING = 1024,
    WIRE_MAX_CHUNK = 4 << 20, /* bytes of a blob or an image in one message */
    WIRE_MAX_PROBE = 1 << 20, /* bytes of the payload of a probe */
    WIRE_MAX_IDENTITY = 255
};
/* The largest payload frame: the raw splat frame of the largest film (6 GiB), or of its light groups, fits.
 */
#define WIRE_MAX_PAYLOAD ((size_t)1 << 33)

/* The life of a job, as JobStatus.state says it. */
typedef enum {
    JOB_QUEUED = 1, /* waiting for a worker, or for its turn */
    JOB_RUNNING,    /* units have been handed out */
    JOB_FINISHING,  /* no more units are handed out; last batches come in, the image is being written */
    JOB_DONE,
    JOB_CANCELLED,
    JOB_FAILED, /* JobStatus.message says why */
    JOB_PAUSED  /* no units are handed out until it is resumed */
} job_state_t;

/* What a client orders done with a job, as JobOrder.kind says it. */
typedef enum {
    ORDER_CANCEL = 1, /* ends it early; its image is written from what is there */
    ORDER_PAUSE,
    ORDER_RESUME,
    ORDER_RETAIN,   /* a finished job is kept until it is deleted, */
    ORDER_RELEASE,  /* or may go when room is needed: the default */
    ORDER_DELETE,   /* a finished job goes, with its film and its image */
    ORDER_PRIORITY, /* order.priority */
    ORDER_EXTEND,   /* more samples, for a finished job or one that runs: order.spp, .error, .time_limit */
    ORDER_MIXED,    /* machines of all kinds may work on it from now on */
    ORDER_REBIND,   /* it is bound to the kind of machines that has most threads now */
    ORDER_TAKE_OUT  /* what order.who delivered to it is taken out and rendered again; job 0: to any */
} order_kind_t;

typedef struct {
    uint64_t job;
    order_kind_t kind;
    int32_t priority;
    uint32_t spp;               /* 0: as it was */
    double error;               /* likewise */
    double time_limit;          /* seconds from now; 0: as it was */
    char who[JOB_MAX_NAME + 1]; /* key, address, or name of a worker */
} job_order_t;

/* What a client orders done with workers, as WorkerOrder.kind says it. */
typedef enum {
    WORKERS_DRAIN = 1, /* they are given nothing more, deliver what they have and leave */
    WORKERS_PURGE = 4  /* those that are gone are forgotten; `who` is not used */
} worker_order_t;
/* True when `who` is the name of a worker, or its host: "node-7" are all workers "node-7:PROCESS". */
bool wire_worker_is(const char *name, const char *who);

/* "queued", "running", ...; "unknown" for anything else. */
const char *job_state_name(uint32_t state);
/* True for JOB_DONE, JOB_CANCELLED and JOB_FAILED. */
bool job_state_final(uint32_t state);

/* What a peer may do. */
enum {
    RIGHT_WORK = 1,   /* say hello, take units, deliver batches, fetch blobs */
    RIGHT_CLIENT = 2, /* submit, order, see jobs, put blobs, fetch images */
    RIGHTS_ALL = RIGHT_WORK | RIGHT_CLIENT
};
enum { WIRE_KEY_TEXT = KEY_TEXT }; /* characters of a public key in Z85 */
enum { WIRE_MAX_ADDRESS = 63 };

/* "may work", "may submit and control jobs", ...: completes a sentence that begins with a key. */
const char *wire_rights_name(unsigned rights);
/* The user id with which a master admits a connection, and wire_receive finds key and rights on its messages.
 */
enum { WIRE_USER_ID = WIRE_KEY_TEXT + 2 };
void wire_user_id(unsigned rights, const char *key, char id[WIRE_USER_ID + 1]);

typedef struct {
    Lm__Envelope *envelope; /* decoded, its body is set; freed by wire_free */
    uint8_t identity[WIRE_MAX_IDENTITY];
    size_t identity_size;                 /* 0 when it came from a DEALER */
    zmq_msg_t header;                     /* until it is decoded, */
    bool header_open;                     /* as this says */
    zmq_msg_t payload[WIRE_MAX_PAYLOADS]; /* open for i < payload_count */
    int payload_count;
    size_t bytes;                /* all frames as they came, without the identity, */
    size_t memory;               /* and with what the decoded header takes */
    unsigned rights;             /* of the sender; RIGHTS_ALL on a connection without keys */
    char key[WIRE_KEY_TEXT + 1]; /* the sender's public key in Z85, empty on a connection without keys */
    int connection;              /* libzmq's file descriptor of it; -1 on inproc and on a DEALER */
    char address[WIRE_MAX_ADDRESS + 1]; /* the sender's host; empty on inproc and on a DEALER */
} wire_message_t;

/* An envelope around a body: WIRE_ENVELOPE(HELLO, hello, &hello). */
#define WIRE_ENVELOPE(kind, field, message)                                                                  \
    (Lm__Envelope)                                                                                           \
    {                                                                                                        \
        .base = PROTOBUF_C_MESSAGE_INIT(&lm__envelope__descriptor), .body_case = LM__ENVELOPE__BODY_##kind,  \
        .field = (message)                                                                                   \
    }

/* Makes a socket with our limits set (largest frame WIRE_MAX_PAYLOAD, high-water marks, linger, reconnect
 * back-off with a ceiling, TCP keep-alive, mandatory routing on a ROUTER). type is ZMQ_ROUTER or ZMQ_DEALER.
 */
result_t wire_socket(void *context, int type, void **socket);
/* Lowers the largest frame that the socket takes in; a connection that sends more is dropped by libzmq before
 * memory is allocated. What encryption adds to a frame is allowed on top. A control socket takes
 * WIRE_MAX_CONTROL_FRAME. Call before bind or connect. */
result_t wire_socket_limit(void *socket, size_t largest_frame);
/* Lowers the number of messages that libzmq takes in, and keeps to be sent, for each connection (64 and 64):
 * what is read no further waits in the peer. Likewise. */
result_t wire_socket_queue(void *socket, int received, int sent);

/* Sends an envelope with its payloads. The identity is for a ROUTER (NULL on a DEALER). Payload messages are
 * consumed, also on failure. Never blocks: RESULT_LIMIT when the peer's queue is full, RESULT_UNREACHABLE
 * when a ROUTER no longer knows the peer. */
result_t wire_send(void *socket, const uint8_t *identity, size_t identity_size, const Lm__Envelope *envelope,
                   zmq_msg_t *payload, int payload_count);

/* Receives one message without blocking. *received is false when there is none. RESULT_PROTOCOL when the
 * message was malformed or over a limit: it has been read to its end and thrown away, and message->identity
 * says who sent it. On success the caller frees the message with wire_free. */
result_t wire_receive(void *socket, bool router, wire_message_t *message, bool *received);
/* The same in two steps, for those who look at the sender before they spend time on the message: its frames,
 * with the envelope NULL, and the decoding of its header. After a failure of either nothing is left to free.
 */
result_t wire_receive_frames(void *socket, bool router, wire_message_t *message, bool *received);
result_t wire_decode(wire_message_t *message);
void wire_free(wire_message_t *message);

/* protobuf-c allocates through this while it decodes: at most *budget bytes in all, which it counts down.
 * What it made is freed with free(). `budget` must outlive the decoding. */
ProtobufCAllocator wire_allocator(size_t *budget);

/* How a unit was issued: what shows it, and the unit that was issued, of which the one at hand may be a
 * piece. */
typedef struct {
    uint64_t mac;           /* of the issued unit (proto/serve/unit_mac.h); 0: it is not known */
    uint32_t before, after; /* samples of it that lie before the piece and behind it */
} issue_t;

/* Settings, units and counts to and from their messages. From a message everything is checked
 * (job_settings_check, job_unit_valid, WIRE_MAX_UNITS); the message of a failure says which field is wrong.
 * A message of settings points to the list in `from`. */
void wire_settings_put(const job_settings_t *from, Lm__Settings *to);
result_t wire_settings_get(const Lm__Settings *from, job_settings_t *to);
/* `name` is not part of the message; a missing message gives the defaults. */
void wire_terms_put(const job_terms_t *from, Lm__Terms *to);
result_t wire_terms_get(const Lm__Terms *from, const char *name, job_terms_t *to);
void wire_order_put(const job_order_t *from, Lm__JobOrder *to);
result_t wire_order_get(const Lm__JobOrder *from, job_order_t *to);
void wire_counts_put(const film_counts_t *from, Lm__Counts *to);
void wire_counts_get(const Lm__Counts *from, film_counts_t *to);
/* The array of messages for `count` units, with how they were issued (NULL: not known), in one piece of
 * memory that the caller frees with free(); NULL for none. */
Lm__Unit **wire_units_new(const unit_t *units, const issue_t *issues, size_t count);
/* Fills units[count] and, unless it is NULL, issues[count], at most WIRE_MAX_UNITS, and checks each unit
 * against the job, unless `settings` is NULL. */
result_t wire_units_get(Lm__Unit *const *messages, size_t count, const job_settings_t *settings,
                        unit_t *units, issue_t *issues);
/* The units and counts of a BatchResult into a zeroed batch, to be freed also after a failure, and how the
 * units were issued, in fresh memory or NULL, to be freed likewise. They are not checked against the job, and
 * its settings are to be filled in; its sums are in the payloads, of which the message has all BATCH_PAYLOADS
 * then. */
result_t wire_batch_get(wire_message_t *message, batch_t *batch, issue_t **issues);
/* The plans that are there, by pass; *count is how many. The caller frees the result. */
Lm__Plan **wire_plans_new(const hash_t plans[LEARNING_PASSES], size_t *count);
/* The reverse, all zero where none is named. RESULT_PROTOCOL when a unit, of those that the plans are for,
 * crosses passes of a job that learns, or has no plan where it needs one. */
result_t wire_plans_get(Lm__Plan *const *messages, size_t message_count, const job_settings_t *settings,
                        const unit_t *units, size_t count, hash_t plans[LEARNING_PASSES]);
/* False when the bytes field is not exactly HASH_BYTES long. */
bool wire_hash_get(const ProtobufCBinaryData *bytes, hash_t *hash);
/* Points the bytes field at the hash, which must outlive the message. */
ProtobufCBinaryData wire_hash_put(const hash_t *hash);

#endif
