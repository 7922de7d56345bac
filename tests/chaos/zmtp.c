/* zmtp: see zmtp.h. */
#include "tests/chaos/zmtp.h"

enum { FLAG_MORE = 1, FLAG_LONG = 2, FLAG_COMMAND = 4, FLAGS = 7 };

bool zmtp_frame(const uint8_t *bytes, size_t size, zmtp_frame_t *frame)
{
    if (size < 2) return false;
    *frame = (zmtp_frame_t){.header = 2,
                            .body = bytes[1],
                            .command = (bytes[0] & FLAG_COMMAND) != 0,
                            .more = (bytes[0] & FLAG_MORE) != 0};
    if (bytes[0] & ~FLAGS) frame->body = SIZE_MAX;
    if ((bytes[0] & FLAG_LONG) == 0 || frame->body == SIZE_MAX) return true;
    frame->header = 9;
    if (size < frame->header) return false;
    uint64_t length = 0;
    for (int i = 1; i < 9; i++) length = length << 8 | bytes[i];
    frame->body = length;
    return true;
}

size_t zmtp_message(const uint8_t *bytes, size_t size, bool *command)
{
    size_t end = 0;
    zmtp_frame_t frame;
    do {
        if (!zmtp_frame(bytes + end, size - end, &frame)) return 0;
        if (frame.body > ZMTP_MAX_FRAME) return SIZE_MAX;
        if (frame.header + frame.body > size - end) return 0;
        *command = frame.command;
        end += frame.header + frame.body;
    } while (frame.more && !frame.command);
    return end;
}

size_t zmtp_body_size(const uint8_t *message, size_t size)
{
    size_t body = 0;
    zmtp_frame_t frame;
    for (size_t at = 0; zmtp_frame(message + at, size - at, &frame); at += frame.header + frame.body)
        body += frame.body;
    return body;
}

size_t zmtp_body_at(const uint8_t *message, size_t size, size_t index)
{
    zmtp_frame_t frame = {0};
    size_t at = 0;
    while (zmtp_frame(message + at, size - at, &frame) && index >= frame.body) {
        index -= frame.body;
        at += frame.header + frame.body;
    }
    return at + frame.header + index;
}
