/* zmtp: where the messages are in the bytes that one end of a ZeroMQ connection sends (ZMTP 3.0, RFC 23):
 * enough to lose, repeat or change whole messages without breaking the stream around them.
 */
#ifndef LIGHTMILL_ZMTP_H
#define LIGHTMILL_ZMTP_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { ZMTP_GREETING = 64, ZMTP_MAX_FRAME = 1 << 28 };

typedef struct {
    size_t header; /* bytes of flags and length */
    size_t body;
    bool command, more;
} zmtp_frame_t;

/* The frame at the start of the bytes behind the greeting; its body may be longer than what is there. False
 * when its header is not all there. A body over ZMTP_MAX_FRAME is none that we understand; it is given as it
 * is. */
bool zmtp_frame(const uint8_t *bytes, size_t size, zmtp_frame_t *frame);

/* The size of the command or the message (all its frames) at the start of the bytes; 0: it is not all there.
 * SIZE_MAX: this is nothing that we understand. *command is true for a command. */
size_t zmtp_message(const uint8_t *bytes, size_t size, bool *command);

/* The bytes of the bodies of a whole message, without the headers of its frames. */
size_t zmtp_body_size(const uint8_t *message, size_t size);
/* Where byte `index` of the bodies lies in the message; index < zmtp_body_size. */
size_t zmtp_body_at(const uint8_t *message, size_t size, size_t index);

#endif
