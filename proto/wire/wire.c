/* wire: see wire.h; PROTOCOL.md describes the bytes.
 *
 * DESIGN. Everything that arrives is untrusted. Three walls stand between a peer's bytes and our memory:
 *
 *   - libzmq drops a connection that announces a frame over ZMQ_MAXMSGSIZE, before it allocates;
 *   - a header may make protobuf-c allocate at most WIRE_MAX_DECODED bytes: the decoder runs on an
 *     allocator with a budget, since a megabyte of empty sub-messages would otherwise unfold to many times
 *     its size;
 *   - one walk over the decoded message, driven by protobuf-c's own descriptors, holds every string, bytes
 *     field and repeated field to its limit. A field that is added to the schema is held too, with no code
 *     here.
 *
 * A message bears a checksum of all its frames. TCP's own is weak and made anew by every box on the way, so a
 * damaged sum could otherwise decode to a plausible batch and be counted.
 *
 * Strings end up in logs and on terminals, so what must not be shown there is replaced as they come in
 * (common/plain_text.h).
 *
 * Sending never blocks: the threads that own sockets serve many peers, and one that does not read must not
 * hold up the others. ZeroMQ decides at the first frame of a message whether there is room for all of it; a
 * later frame can only fail because the connection went away meanwhile, and then the rest still has to be
 * handed over so that ZeroMQ discards the message whole. */
#include "proto/wire/wire.h"

#include "common/plain_text.h"
#include "proto/wire/checksum.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const uint8_t PREAMBLE[] = {'L', 'M', 'I', 'L', WIRE_VERSION};
enum { ENVELOPE_AT = sizeof PREAMBLE + sizeof(uint32_t) }; /* behind the checksum */

/* libzmq is not built with the thread sanitizer, which therefore does not see that a message is handed over,
 * at inproc with its memory: what was done before a message was sent comes before what is done after one was
 * received. */
#ifdef __SANITIZE_THREAD__
void __tsan_acquire(void *address);
void __tsan_release(void *address);
static void note_sending(void)
{
    __tsan_release((void *)PREAMBLE);
}
static void note_receiving(void)
{
    __tsan_acquire((void *)PREAMBLE);
}
#else
static void note_sending(void)
{
}
static void note_receiving(void)
{
}
#endif

/* Socket options. Times are in ms, keep-alive in seconds. */
enum {
    ENCRYPTION_OVERHEAD = 64, /* bytes, at least what CURVE adds to a frame (33) */
    HIGH_WATER_MARK = 64,     /* messages queued a connection; peers have few requests open at a time */
    LINGER_MS = 1000,
    RECONNECT_MS = 100,
    RECONNECT_MAX_MS = 500, /* a master that was restarted is to be found within a second */
    CONNECT_TIMEOUT_MS = 5000,
    UNACKNOWLEDGED_MAX_MS = 15000, /* then a connection counts as broken; one that is slow does not */
    KEEP_ALIVE_IDLE = 10,
    KEEP_ALIVE_INTERVAL = 3,
    KEEP_ALIVE_COUNT = 3
};

/* ---- sockets ------------------------------------------------------------------------------------------- */

result_t wire_socket_limit(void *socket, size_t largest_frame)
{
    int64_t limit = (int64_t)largest_frame + ENCRYPTION_OVERHEAD;
    if (zmq_setsockopt(socket, ZMQ_MAXMSGSIZE, &limit, sizeof limit) == 0) return result_ok();
    return result_fail(RESULT_IO, "cannot limit a socket's messages: %s", zmq_strerror(errno));
}

result_t wire_socket_queue(void *socket, int received, int sent)
{
    /* On a connection with a key libzmq queues the key first, counts it, and never counts it as taken out:
     * with a limit of 1 nothing would ever come. */
    received++;
    if (zmq_setsockopt(socket, ZMQ_RCVHWM, &received, sizeof received) == 0 &&
        zmq_setsockopt(socket, ZMQ_SNDHWM, &sent, sizeof sent) == 0)
        return result_ok();
    return result_fail(RESULT_IO, "cannot limit a socket's queues: %s", zmq_strerror(errno));
}

static result_t set_options(void *socket, int type)
{
    const struct {
        int option, value;
    } options[] = {{ZMQ_SNDHWM, HIGH_WATER_MARK},
                   {ZMQ_RCVHWM, HIGH_WATER_MARK},
                   {ZMQ_LINGER, LINGER_MS},
                   {ZMQ_RECONNECT_IVL, RECONNECT_MS},
                   {ZMQ_RECONNECT_IVL_MAX, RECONNECT_MAX_MS},
                   {ZMQ_CONNECT_TIMEOUT, CONNECT_TIMEOUT_MS},
                   {ZMQ_TCP_MAXRT, UNACKNOWLEDGED_MAX_MS},
                   {ZMQ_TCP_KEEPALIVE, 1},
                   {ZMQ_TCP_KEEPALIVE_IDLE, KEEP_ALIVE_IDLE},
                   {ZMQ_TCP_KEEPALIVE_INTVL, KEEP_ALIVE_INTERVAL},
                   {ZMQ_TCP_KEEPALIVE_CNT, KEEP_ALIVE_COUNT}};
    for (size_t i = 0; i < ARRAY_LENGTH(options); i++)
        if (zmq_setsockopt(socket, options[i].option, &options[i].value, sizeof options[i].value) != 0)
            return result_fail(RESULT_IO, "cannot set socket option %d: %s", options[i].option,
                               zmq_strerror(errno));
    int mandatory = 1;
    if (type == ZMQ_ROUTER && zmq_setsockopt(socket, ZMQ_ROUTER_MANDATORY, &mandatory, sizeof mandatory) != 0)
        return result_fail(RESULT_IO, "cannot make routing mandatory: %s", zmq_strerror(errno));
    return wire_socket_limit(socket, WIRE_MAX_PAYLOAD);
}

result_t wire_socket(void *context, int type, void **socket)
{
    *socket = zmq_socket(context, type);
    if (*socket == NULL) return result_fail(RESULT_IO, "cannot make a socket: %s", zmq_strerror(errno));
    result_t result = set_options(*socket, type);
    if (result.code != RESULT_OK) {
        zmq_close(*socket);
        *socket = NULL;
    }
    return result;
}

/* ---- sending ------------------------------------------------------------------------------------------- */

/* Of the packed envelope and of the sizes and bytes of the payloads. */
static uint32_t message_checksum(const uint8_t *envelope, size_t size, const zmq_msg_t *payload,
                                 int payload_count)
{
    uint32_t sum = checksum_add(0, envelope, size);
    for (int i = 0; i < payload_count; i++) {
        uint64_t length = zmq_msg_size(&payload[i]);
        sum = checksum_add(sum, &length, sizeof length);
        sum = checksum_add(sum, zmq_msg_data((zmq_msg_t *)&payload[i]), length);
    }
    return sum;
}

static result_t header_encode(const Lm__Envelope *envelope, const zmq_msg_t *payload, int payload_count,
                              zmq_msg_t *header)
{
    size_t size = ENVELOPE_AT + lm__envelope__get_packed_size(envelope);
    if (size > WIRE_MAX_HEADER)
        return result_fail(RESULT_LIMIT, "a message header of %zu bytes is over the limit of %d", size,
                           WIRE_MAX_HEADER);
    if (zmq_msg_init_size(header, size) != 0)
        return result_fail(RESULT_LIMIT, "no memory for a message header of %zu bytes", size);
    uint8_t *bytes = zmq_msg_data(header);
    memcpy(bytes, PREAMBLE, sizeof PREAMBLE);
    lm__envelope__pack(envelope, bytes + ENVELOPE_AT);
    uint32_t sum = message_checksum(bytes + ENVELOPE_AT, size - ENVELOPE_AT, payload, payload_count);
    memcpy(bytes + sizeof PREAMBLE, &sum, sizeof sum);
    return result_ok();
}

static result_t send_failure(int error)
{
    switch (error) {
    case EAGAIN:
        return result_fail(RESULT_LIMIT, "the peer does not keep up: its queue of messages is full");
    case EHOSTUNREACH:
        return result_fail(RESULT_UNREACHABLE, "the peer is no longer connected");
    default:
        return result_fail(RESULT_IO, "cannot send a message: %s", zmq_strerror(error));
    }
}

/* Sends the first frame. libzmq looks about once a millisecond whether a peer has read anything, so a queue
 * that looks full may have been emptied since; asking for the socket's events makes it look. */
static bool send_first(void *socket, zmq_msg_t *frame, int flags)
{
    int events;
    size_t size = sizeof events;
    if (zmq_msg_send(frame, socket, flags) >= 0) return true;
    if (errno != EAGAIN || zmq_getsockopt(socket, ZMQ_EVENTS, &events, &size) != 0) return false;
    return zmq_msg_send(frame, socket, flags) >= 0;
}

/* Sends the frames of one message; those that ZeroMQ did not take are closed. */
static result_t send_frames(void *socket, zmq_msg_t **frames, int count)
{
    int error = 0;
    for (int i = 0; i < count; i++) {
        int flags = ZMQ_DONTWAIT | (i + 1 < count ? ZMQ_SNDMORE : 0);
        bool refused_whole = error != 0 && i == 1; /* see the note at the top of the file */
        if (refused_whole) {
            for (; i < count; i++) zmq_msg_close(frames[i]);
            break;
        }
        if (i == 0 ? send_first(socket, frames[i], flags) : zmq_msg_send(frames[i], socket, flags) >= 0)
            continue;
        if (error == 0) error = errno;
        zmq_msg_close(frames[i]);
    }
    return error == 0 ? result_ok() : send_failure(error);
}

result_t wire_send(void *socket, const uint8_t *identity, size_t identity_size, const Lm__Envelope *envelope,
                   zmq_msg_t *payload, int payload_count)
{
    zmq_msg_t address, header;
    zmq_msg_t *frames[2 + WIRE_MAX_PAYLOADS];
    int count = 0;
    result_t result = header_encode(envelope, payload, payload_count, &header);
    if (result.code == RESULT_OK && identity != NULL) {
        if (zmq_msg_init_size(&address, identity_size) == 0) {
            memcpy(zmq_msg_data(&address), identity, identity_size);
            frames[count++] = &address;
        } else {
            zmq_msg_close(&header);
            result = result_fail(RESULT_LIMIT, "no memory for a message");
        }
    }
    if (result.code != RESULT_OK) {
        for (int i = 0; i < payload_count; i++) zmq_msg_close(&payload[i]);
        return result;
    }
    frames[count++] = &header;
    for (int i = 0; i < payload_count && i < WIRE_MAX_PAYLOADS; i++) frames[count++] = &payload[i];
    note_sending();
    return send_frames(socket, frames, count);
}

/* ---- decoding a header --------------------------------------------------------------------------------- */

static void *budget_alloc(void *budget, size_t size)
{
    size_t *left = budget;
    if (size > *left) return NULL;
    *left -= size;
    return malloc(size);
}

static void budget_free(void *budget, void *memory)
{
    (void)budget;
    free(memory);
}

ProtobufCAllocator wire_allocator(size_t *budget)
{
    return (ProtobufCAllocator){budget_alloc, budget_free, budget};
}

static result_t message_check(ProtobufCMessage *message);

static result_t string_check(char *text, const char *name)
{
    size_t length = strlen(text);
    if (length > WIRE_MAX_STRING)
        return result_fail(RESULT_PROTOCOL, "%s has %zu characters, the limit is %d", name, length,
                           WIRE_MAX_STRING);
    plain_text_clean(text);
    return result_ok();
}

/* One value of a field: a string, bytes or a message; numbers have nothing to check here. */
static result_t value_check(const ProtobufCFieldDescriptor *field, void *value)
{
    switch (field->type) {
    case PROTOBUF_C_TYPE_STRING: {
        char *text = *(char **)value;
        return text == NULL || text == protobuf_c_empty_string ? result_ok()
                                                               : string_check(text, field->name);
    }
    case PROTOBUF_C_TYPE_BYTES: {
        size_t length = ((ProtobufCBinaryData *)value)->len;
        if (length <= WIRE_MAX_STRING) return result_ok();
        return result_fail(RESULT_PROTOCOL, "%s has %zu bytes, the limit is %d", field->name, length,
                           WIRE_MAX_STRING);
    }
    case PROTOBUF_C_TYPE_MESSAGE: {
        ProtobufCMessage *message = *(ProtobufCMessage **)value;
        return message == NULL ? result_ok() : message_check(message);
    }
    default:
        return result_ok();
    }
}

static result_t repeated_check(const ProtobufCFieldDescriptor *field, size_t count, void **values)
{
    if (count > WIRE_MAX_UNITS)
        return result_fail(RESULT_PROTOCOL, "%zu %s, the limit is %d", count, field->name, WIRE_MAX_UNITS);
    bool pointers = field->type == PROTOBUF_C_TYPE_STRING || field->type == PROTOBUF_C_TYPE_MESSAGE;
    for (size_t i = 0; pointers && i < count; i++) TRY(value_check(field, &values[i]));
    return result_ok();
}

static result_t message_check(ProtobufCMessage *message)
{
    uint8_t *base = (uint8_t *)message;
    for (unsigned i = 0; i < message->descriptor->n_fields; i++) {
        const ProtobufCFieldDescriptor *field = &message->descriptor->fields[i];
        void *value = base + field->offset;
        bool one_of = (field->flags & PROTOBUF_C_FIELD_FLAG_ONEOF) != 0;
        if (one_of && *(uint32_t *)(base + field->quantifier_offset) != field->id) continue;
        if (field->label == PROTOBUF_C_LABEL_REPEATED)
            TRY(repeated_check(field, *(size_t *)(base + field->quantifier_offset), *(void ***)value));
        else
            TRY(value_check(field, value));
    }
    return result_ok();
}

/* What stands in front of the envelope. */
static result_t header_check(const uint8_t *bytes, size_t size, const zmq_msg_t *payload, int payload_count)
{
    if (size < sizeof PREAMBLE || memcmp(bytes, PREAMBLE, sizeof PREAMBLE - 1) != 0)
        return result_fail(RESULT_PROTOCOL, "a message of %zu bytes does not begin like one of ours", size);
    if (bytes[sizeof PREAMBLE - 1] != WIRE_VERSION)
        return result_fail(RESULT_PROTOCOL,
                           "the peer speaks protocol %d, this program speaks %d: both need the same "
                           "version of Lightmill",
                           bytes[sizeof PREAMBLE - 1], WIRE_VERSION);
    if (size > WIRE_MAX_HEADER)
        return result_fail(RESULT_PROTOCOL, "a header of %zu bytes is over the limit of %d", size,
                           WIRE_MAX_HEADER);
    if (size <= ENVELOPE_AT)
        return result_fail(RESULT_PROTOCOL, "a header of %zu bytes holds no message", size);
    uint32_t sum;
    memcpy(&sum, bytes + sizeof PREAMBLE, sizeof sum);
    if (sum == message_checksum(bytes + ENVELOPE_AT, size - ENVELOPE_AT, payload, payload_count))
        return result_ok();
    return result_fail(RESULT_PROTOCOL, "a message was damaged on its way: its checksum is wrong");
}

/* The envelope alone. */
static result_t header_decode(const uint8_t *bytes, size_t size, Lm__Envelope **envelope, size_t *memory)
{
    size_t budget = WIRE_MAX_DECODED;
    ProtobufCAllocator allocator = wire_allocator(&budget);
    Lm__Envelope *made = lm__envelope__unpack(&allocator, size, bytes);
    if (made == NULL) return result_fail(RESULT_PROTOCOL, "a header of %zu bytes does not decode", size);
    result_t result = message_check(&made->base);
    if (result.code == RESULT_OK && made->body_case == LM__ENVELOPE__BODY__NOT_SET)
        result = result_fail(RESULT_PROTOCOL, "a message of no known kind");
    *memory = WIRE_MAX_DECODED - budget;
    if (result.code == RESULT_OK)
        *envelope = made;
    else
        lm__envelope__free_unpacked(made, NULL);
    return result;
}

/* ---- receiving ----------------------------------------------------------------------------------------- */

/* Reads the next frame into an open `frame`; false when there is none. */
static bool next_frame(void *socket, zmq_msg_t *frame, int *error)
{
    zmq_msg_init(frame);
    int rc;
    do rc = zmq_msg_recv(frame, socket, ZMQ_DONTWAIT);
    while (rc < 0 && errno == EINTR);
    if (rc >= 0) return true;
    *error = errno;
    zmq_msg_close(frame);
    return false;
}

/* Reads and drops the frames that follow `frame`; returns how many bytes those were. */
static size_t drain(void *socket, bool more)
{
    size_t bytes = 0;
    int error;
    while (more) {
        zmq_msg_t frame;
        if (!next_frame(socket, &frame, &error)) break;
        bytes += zmq_msg_size(&frame);
        more = zmq_msg_more(&frame) != 0;
        zmq_msg_close(&frame);
    }
    return bytes;
}

static result_t receive_identity(void *socket, wire_message_t *message, bool *received)
{
    zmq_msg_t frame;
    int error;
    if (!next_frame(socket, &frame, &error)) {
        if (error == EAGAIN) return result_ok();
        return result_fail(RESULT_IO, "cannot receive: %s", zmq_strerror(error));
    }
    size_t size = zmq_msg_size(&frame);
    bool more = zmq_msg_more(&frame) != 0, fits = size > 0 && size <= WIRE_MAX_IDENTITY;
    if (fits) {
        memcpy(message->identity, zmq_msg_data(&frame), size);
        message->identity_size = size;
    }
    zmq_msg_close(&frame);
    if (fits && more) {
        *received = true;
        return result_ok();
    }
    drain(socket, more);
    return result_fail(RESULT_PROTOCOL, "a message without a header");
}

/* The frames after the header. */
static result_t receive_payloads(void *socket, bool more, wire_message_t *message)
{
    while (more) {
        zmq_msg_t *frame = &message->payload[message->payload_count];
        int error;
        if (message->payload_count == WIRE_MAX_PAYLOADS) {
            message->bytes += drain(socket, true);
            return result_fail(RESULT_PROTOCOL, "a message with more than %d payloads", WIRE_MAX_PAYLOADS);
        }
        if (!next_frame(socket, frame, &error))
            return result_fail(RESULT_IO, "cannot receive a payload: %s", zmq_strerror(error));
        message->payload_count++;
        message->bytes += zmq_msg_size(frame);
        more = zmq_msg_more(frame) != 0;
        if (zmq_msg_size(frame) > WIRE_MAX_PAYLOAD) {
            message->bytes += drain(socket, more);
            return result_fail(RESULT_PROTOCOL, "a payload of %zu bytes is over the limit",
                               zmq_msg_size(frame));
        }
    }
    return result_ok();
}

void wire_user_id(unsigned rights, const char *key, char id[WIRE_USER_ID + 1])
{
    snprintf(id, WIRE_USER_ID + 1, "%u %.*s", rights & RIGHTS_ALL, WIRE_KEY_TEXT, key);
}

/* The reverse; a user id of any other form gives no right at all. */
static void read_user_id(const char *id, wire_message_t *message)
{
    message->rights = 0;
    if (id == NULL || strlen(id) != WIRE_USER_ID || id[0] < '0' || id[0] > '0' + RIGHTS_ALL || id[1] != ' ')
        return;
    message->rights = (unsigned)(id[0] - '0');
    memcpy(message->key, id + 2, sizeof message->key);
}

/* Who sent it. Without keys a peer can give itself any user id, so only one of a connection with keys is
 * believed. */
static void receive_sender(void *socket, const zmq_msg_t *header, wire_message_t *message)
{
    int mechanism = ZMQ_NULL;
    size_t size = sizeof mechanism;
    const char *address = zmq_msg_gets(header, "Peer-Address");
    message->connection = zmq_msg_get(header, ZMQ_SRCFD);
    if (address != NULL) snprintf(message->address, sizeof message->address, "%s", address);
    if (zmq_getsockopt(socket, ZMQ_MECHANISM, &mechanism, &size) != 0 || mechanism == ZMQ_CURVE)
        read_user_id(zmq_msg_gets(header, "User-Id"), message);
}

result_t wire_receive_frames(void *socket, bool router, wire_message_t *message, bool *received)
{
    message->envelope = NULL;
    message->identity_size = 0;
    message->header_open = false;
    message->payload_count = 0;
    message->bytes = 0;
    message->rights = RIGHTS_ALL;
    message->key[0] = '\0';
    message->address[0] = '\0';
    message->connection = -1;
    *received = false;
    if (router) {
        TRY(receive_identity(socket, message, received));
        if (!*received) return result_ok();
    }
    *received = false;
    int error;
    if (!next_frame(socket, &message->header, &error)) {
        if (error == EAGAIN && !router) return result_ok();
        return result_fail(RESULT_IO, "cannot receive: %s", zmq_strerror(error));
    }
    note_receiving();
    message->header_open = true;
    message->bytes = zmq_msg_size(&message->header);
    if (router) receive_sender(socket, &message->header, message);
    result_t result = receive_payloads(socket, zmq_msg_more(&message->header) != 0, message);
    if (result.code != RESULT_OK) wire_free(message);
    *received = result.code == RESULT_OK;
    return result;
}

result_t wire_decode(wire_message_t *message)
{
    const uint8_t *bytes = zmq_msg_data(&message->header);
    size_t size = zmq_msg_size(&message->header), decoded = 0;
    result_t result = header_check(bytes, size, message->payload, message->payload_count);
    if (result.code == RESULT_OK)
        result = header_decode(bytes + ENVELOPE_AT, size - ENVELOPE_AT, &message->envelope, &decoded);
    message->memory = message->bytes + decoded;
    zmq_msg_close(&message->header);
    message->header_open = false;
    if (result.code != RESULT_OK) wire_free(message);
    return result;
}

result_t wire_receive(void *socket, bool router, wire_message_t *message, bool *received)
{
    TRY(wire_receive_frames(socket, router, message, received));
    if (!*received) return result_ok();
    result_t result = wire_decode(message);
    *received = result.code == RESULT_OK;
    return result;
}

void wire_free(wire_message_t *message)
{
    if (message->envelope != NULL) lm__envelope__free_unpacked(message->envelope, NULL);
    message->envelope = NULL;
    if (message->header_open) zmq_msg_close(&message->header);
    message->header_open = false;
    for (int i = 0; i < message->payload_count; i++) zmq_msg_close(&message->payload[i]);
    message->payload_count = 0;
}
