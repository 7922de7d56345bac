/* peer: a scripted worker or client for tests of the master: it speaks the protocol over real sockets,
 * exactly as the test says and no better. Calls end the running test when an answer does not come within
 * seconds.
 */
#ifndef LIGHTMILL_PEER_H
#define LIGHTMILL_PEER_H

#include "proto/uplink/issued.h"

typedef struct {
    void *context; /* its own */
    void *control, *bulk;
    uint64_t requests;
    uint64_t worker; /* after peer_hello */
    /* What it says of itself; "peer" and nothing unless the test sets them. */
    const char *name;
    hash_t fingerprint;
    bool unprobed; /* peer_hello does not probe the bulk socket */
    /* Pushed messages that came while an answer was awaited. */
    int job_ready, job_over, flush;
    uint64_t over_job;
    issued_t issued; /* units of assignments, as a worker remembers them: batches bear their MACs */
} peer_t;

/* Connects to a master on loopback; asks it for its bulk port. */
peer_t *peer_new(int control_port);
/* The same from another address of this machine: another party to the master. */
peer_t *peer_new_from(const char *host, int control_port);
void peer_destroy(peer_t **peer);
/* Socket without our limits, for hostile bytes; `bulk` chooses the master's socket. Close with zmq_close. */
void *peer_raw_socket(peer_t *peer, bool bulk);

/* Sends a request and waits for its answer; payloads are consumed. The caller frees the answer with
 * wire_free. */
wire_message_t peer_ask_control(peer_t *peer, Lm__Envelope *envelope);
wire_message_t peer_ask_bulk(peer_t *peer, Lm__Envelope *envelope, zmq_msg_t *payload, int payloads);
/* Takes in pushed messages for some seconds, or until one has come. */
void peer_listen(peer_t *peer, double seconds);

enum { PEER_ENVELOPE_AT = 9 }; /* in a header frame: "LMIL", the version, the checksum */
/* Writes the checksum into a header frame that `count` payloads follow; not into one that is too short. */
void peer_seal(uint8_t *header, size_t size, const void *const *payloads, const size_t *sizes, int count);

/* Says hello; *refused (may be NULL) takes the reason of a refusal, which otherwise ends the test. */
void peer_hello(peer_t *peer, uint32_t version, uint32_t threads, result_t *refused);
/* Sends a probe with so many bytes to the bulk socket; the master's verdict. */
result_t peer_probe(peer_t *peer, size_t bytes);
bool peer_heartbeat(peer_t *peer, uint64_t job, uint32_t units_held);
void peer_goodbye(peer_t *peer);

/* What a WorkRequest brought. */
typedef struct {
    uint64_t job; /* 0: no work */
    uint64_t check;
    job_settings_t settings;
    unit_t units[WIRE_MAX_UNITS];
    issue_t issues[WIRE_MAX_UNITS];
    size_t unit_count;
    result_t refused;
} peer_work_t;
void peer_work(peer_t *peer, uint64_t samples, uint64_t unit_samples, peer_work_t *work);

/* How the peer was assigned units, to be freed with free(). */
issue_t *peer_issues(peer_t *peer, const unit_t *units, size_t count);
/* Renders units as no renderer would, but always the same way, into a batch that the caller frees. */
batch_t peer_render(const job_settings_t *settings, const unit_t *units, size_t count);
/* Sends a batch and returns the master's verdict: RESULT_OK, or RESULT_MISMATCH with the reason. */
result_t peer_send_batch(peer_t *peer, uint64_t job, const batch_t *batch);
/* The same, for an assignment that bears a number. */
result_t peer_send_check(peer_t *peer, uint64_t job, uint64_t check, const batch_t *batch);

/* A small valid scene blob in fresh memory; `variant` makes different ones. */
uint8_t *peer_blob(uint32_t variant, uint64_t *size, hash_t *hash);
/* Sends a blob in chunks; the master's verdict. */
result_t peer_put_blob(peer_t *peer, const uint8_t *bytes, uint64_t size, const hash_t *hash, size_t chunk);
/* One BlobPut; *next takes the answer. */
result_t peer_put_chunk(peer_t *peer, const hash_t *hash, uint64_t offset, uint64_t size, const void *bytes,
                        size_t length, uint64_t *next);
result_t peer_submit(peer_t *peer, const char *name, const job_settings_t *settings, const hash_t *hash,
                     uint64_t *job);
result_t peer_cancel(peer_t *peer, uint64_t job);
/* The status of one job; the message must be freed, with wire_free. NULL when the master refuses. */
const Lm__JobStatus *peer_status(peer_t *peer, uint64_t job, wire_message_t *message);
/* Waits up to `seconds` for the job to reach its last state, and returns it. */
job_state_t peer_wait(peer_t *peer, uint64_t job, double seconds);
/* Fetches the image so far into a file. */
result_t peer_fetch(peer_t *peer, uint64_t job, bool half, uint32_t chunk, const char *path);

#endif
