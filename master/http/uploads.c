/* uploads: the blobs of scenes, sent by HTTP. A body of any length is handed piece by piece to the thread
 * that writes to the blob store; while a piece is written, the connection is put aside. An upload that breaks
 * off leaves what came whole, and goes on from there, by whichever way it comes. */
#include "master/http/routes.h"
#include "master/http/server_state.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { PIECE = 1 << 20 }; /* bytes that are handed over at a time */

typedef struct {
    hash_t blob;
    uint64_t size;    /* of the blob, bytes */
    uint64_t first;   /* where the body lies in it, */
    uint64_t length;  /* and its length */
    uint64_t next;    /* that the store wants next */
    uint64_t start;   /* where the buffer lies in the blob */
    size_t held;      /* bytes in it */
    bool known;       /* the blob was there before */
    bool asked;       /* a piece was handed over, whose outcome has not been looked at */
    bool told;        /* the store has said what it has */
    bool stuck;       /* it takes nothing of the last piece: somebody else began anew */
    result_t failure; /* what follows is read and dropped */
    uint8_t *buffer;  /* PIECE bytes */
} upload_t;

/* ---- what is there ------------------------------------------------------------------------------------- */

static void reply_blob(http_request_t *request, unsigned status, const hash_t *blob, uint64_t next,
                       bool complete)
{
    json_t *object = json_object();
    put_hash(object, "blob", blob);
    put_count(object, "next", next);
    put_flag(object, "complete", complete);
    http_reply_json(request, status, object);
}

static void show_blob(http_request_t *request)
{
    bool complete;
    uint64_t next = request->master->find_blob(request->master->context, &request->hash, &complete);
    if (next > 0)
        reply_blob(request, MHD_HTTP_OK, &request->hash, next, complete);
    else
        http_reply_problem(request, MHD_HTTP_NOT_FOUND, "this master has nothing of the blob");
}

/* ---- what is said of the body -------------------------------------------------------------------------- */

/* Where the body lies in the blob. The status of the refusal and its reason, or 0. */
static unsigned read_place(const http_request_t *request, upload_t *upload, const char **reason)
{
    const char *length = http_header(request, MHD_HTTP_HEADER_CONTENT_LENGTH);
    const char *range = http_header(request, MHD_HTTP_HEADER_CONTENT_RANGE);
    uint64_t bytes;
    *reason = "say the length of the body (Content-Length)";
    if (length == NULL || !http_number_parse(length, strlen(length), &bytes)) return MHD_HTTP_LENGTH_REQUIRED;
    *upload = (upload_t){.size = bytes, .length = bytes};
    *reason = "Content-Range is 'bytes FIRST-LAST/SIZE', and the body has the bytes from FIRST to LAST";
    if (range != NULL &&
        (!http_range_parse(range, &upload->first, &upload->length, &upload->size) || upload->length != bytes))
        return MHD_HTTP_BAD_REQUEST;
    *reason = "a blob has from 1 byte to 64 GiB";
    return upload->size == 0 || upload->size > BLOB_MAX_BYTES ? MHD_HTTP_CONTENT_TOO_LARGE : 0;
}

/* ---- the end ------------------------------------------------------------------------------------------- */

static void release(http_request_t *request)
{
    upload_t *upload = request->own;
    free(upload->buffer);
    free(upload);
    request->server->uploads--;
}

static void reply_failure(http_request_t *request, const result_t *failure)
{
    switch (failure->code) {
    case RESULT_INPUT: /* the blob is wrong */
        http_reply_problem(request, MHD_HTTP_UNPROCESSABLE_CONTENT, failure->message);
        break;
    case RESULT_LIMIT: /* there is no room */
    case RESULT_IO:
        http_reply_problem(request, MHD_HTTP_INSUFFICIENT_STORAGE, failure->message);
        break;
    default:
        http_reply_failure(request, failure);
    }
}

static void reply_elsewhere(http_request_t *request, uint64_t next)
{
    char detail[100];
    snprintf(detail, sizeof detail, "the blob goes on at byte %" PRIu64 ": send it from there", next);
    http_reply_problem(request, MHD_HTTP_CONFLICT, detail);
}

static void reply_outcome(http_request_t *request)
{
    const upload_t *upload = request->own;
    bool complete = upload->next == upload->size;
    if (upload->failure.code != RESULT_OK)
        reply_failure(request, &upload->failure);
    else if (upload->next < upload->first + upload->length)
        reply_elsewhere(request, upload->next);
    else
        reply_blob(request,
                   upload->known ? MHD_HTTP_OK
                   : complete    ? MHD_HTTP_CREATED
                                 : MHD_HTTP_ACCEPTED,
                   &upload->blob, upload->next, complete);
}

/* ---- the body ------------------------------------------------------------------------------------------ */

static void finish(http_request_t *request);

static void on_put(void *ticket, const result_t *result, uint64_t next)
{
    http_request_t *request = ticket;
    request->result = *result;
    request->value = next;
    http_go(request);
}

/* Hands over what is held, and puts the request aside until it is written. */
static void hand_over(http_request_t *request)
{
    upload_t *upload = request->own;
    http_piece_t piece = {upload->blob, upload->start, upload->size, upload->buffer, upload->held};
    if (!http_wait(request, finish)) {
        upload->failure = result_fail(RESULT_LIMIT, "it is answered already");
        return;
    }
    upload->asked = true;
    result_t result = request->master->put_blob(request->master->context, &piece, on_put, request);
    if (result.code != RESULT_OK) on_put(request, &result, upload->start);
}

/* Looks at what became of the last piece. What the store did not take, because it has some of it already,
 * stays held. */
static void look(http_request_t *request)
{
    upload_t *upload = request->own;
    if (!upload->asked) return;
    upload->asked = false;
    if (request->result.code != RESULT_OK) {
        upload->failure = request->result;
        return;
    }
    upload->told = true;
    upload->next = request->value;
    uint64_t end = upload->start + upload->held, from = upload->next < end ? upload->next : end;
    upload->stuck = from <= upload->start && upload->held > 0;
    if (from <= upload->start) return;
    memmove(upload->buffer, upload->buffer + (from - upload->start), end - from);
    upload->held = end - from;
    upload->start = from;
}

/* Nothing more of the body is wanted. */
static bool is_lost(const upload_t *upload)
{
    return upload->failure.code != RESULT_OK || upload->stuck;
}

/* Takes what fits into the buffer, from where the store wants to go on. */
static size_t hold(upload_t *upload, const char *bytes, size_t size)
{
    uint64_t at = upload->start + upload->held;
    if (upload->held == 0 && at < upload->next) { /* these are there */
        uint64_t skip = upload->next - at < size ? upload->next - at : size;
        upload->start += skip;
        return (size_t)skip;
    }
    size_t room = PIECE - upload->held, count = size < room ? size : room;
    memcpy(upload->buffer + upload->held, bytes, count);
    upload->held += count;
    return count;
}

/* Takes bytes of the body as they come; those that are not taken come again. */
static void take(http_request_t *request, const char *bytes, size_t *size)
{
    upload_t *upload = request->own;
    look(request);
    while (*size > 0 && !upload->asked) {
        size_t taken = is_lost(upload) ? *size : hold(upload, bytes, *size);
        bytes += taken;
        *size -= taken;
        if (!is_lost(upload) && upload->held == PIECE) hand_over(request);
    }
}

/* The body is there. The store is asked at least once: what it has may be complete, but not checked. */
static void finish(http_request_t *request)
{
    upload_t *upload = request->own;
    look(request);
    bool more = upload->held > 0 || !(upload->told || upload->known);
    if (more && !is_lost(upload))
        hand_over(request);
    else
        reply_outcome(request);
}

/* Can it be told already, without the body? What is there need not be sent by who waits to be asked for it.
 */
static bool is_answered(http_request_t *request, const upload_t *place)
{
    if (place->next < place->first)
        reply_elsewhere(request, place->next);
    else if (place->known && place->next != place->size)
        http_reply_problem(request, MHD_HTTP_UNPROCESSABLE_CONTENT, "the blob of this hash has another size");
    else if (place->known && http_header(request, MHD_HTTP_HEADER_EXPECT) != NULL)
        reply_blob(request, MHD_HTTP_OK, &place->blob, place->next, true);
    else if (request->server->uploads >= HTTP_MAX_UPLOADS)
        http_reply_problem(request, MHD_HTTP_SERVICE_UNAVAILABLE,
                           "too many scenes are being sent already: try again");
    else
        return false;
    return true;
}

/* The headers are there. */
static void put_blob(http_request_t *request)
{
    upload_t place, *upload;
    const char *reason;
    unsigned status = read_place(request, &place, &reason);
    if (status != 0) {
        http_reply_problem(request, status, reason);
        return;
    }
    place.blob = request->hash;
    place.start = place.first;
    place.next = request->master->find_blob(request->master->context, &place.blob, &place.known);
    if (is_answered(request, &place)) return;
    request->own = upload = mem_alloc(sizeof *upload);
    *upload = place;
    upload->buffer = mem_alloc(PIECE);
    request->release = release;
    request->server->uploads++;
    request->take = take;
    request->then = finish;
}

static const http_route_t routes[] = {{"GET", "/api/v1/blobs/@", HTTP_VIEW, show_blob},
                                      {"PUT", "/api/v1/blobs/@", HTTP_OPERATE, put_blob}};
const http_table_t http_upload_routes = {routes, ARRAY_LENGTH(routes)};
