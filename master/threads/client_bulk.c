/* client_bulk: see client_bulk.h. Images are made by the image writer, whose answers come later. (A scene
 * whose last byte has come is checked here, about a second a GB; batches wait so long, and nothing is lost by
 * it.)
 */
#include "master/threads/client_bulk.h"

#include "proto/serve/bulk_server.h"

static const double NEWS_INTERVAL = 1; /* seconds */

/* ---- scenes -------------------------------------------------------------------------------------------- */

static result_t put_blob(client_bulk_t *client, const wire_message_t *message, uint64_t *next)
{
    const Lm__BlobPut *put = message->envelope->blob_put;
    zmq_msg_t *payload = (zmq_msg_t *)&message->payload[0];
    hash_t hash;
    TRY(bulk_hash_get(&put->blob, &hash));
    if (message->payload_count != 1 || zmq_msg_size(payload) > WIRE_MAX_CHUNK)
        return result_fail(RESULT_PROTOCOL, "a part of a blob comes in one payload of at most %d bytes",
                           WIRE_MAX_CHUNK);
    if (put->offset > put->size)
        return result_fail(RESULT_PROTOCOL, "an offset beyond the blob's %llu bytes",
                           (unsigned long long)put->size);
    return blob_store_put(client->store, &hash, put->offset, put->size, zmq_msg_data(payload),
                          zmq_msg_size(payload), next);
}

static void on_blob_put(void *self, peer_server_t *server, const wire_message_t *message)
{
    Lm__BlobPutReply answer = LM__BLOB_PUT_REPLY__INIT;
    result_t result = put_blob(self, message, &answer.next);
    if (result.code == RESULT_OK) {
        peer_reply(server, message, LM__ENVELOPE__BODY_BLOB_PUT_REPLY, &answer, NULL);
        return;
    }
    peer_complain(server, "an upload is refused: %s", result.message);
    peer_refuse(server, message, result);
}

/* ---- images -------------------------------------------------------------------------------------------- */

static result_t get_image(client_bulk_t *client, uint64_t snapshot, const image_request_t *request,
                          Lm__ImageChunk *chunk, zmq_msg_t *payload)
{
    uint64_t size = 0;
    size_t length = 0;
    chunk->snapshot = snapshot;
    chunk->offset = request->offset;
    chunk->at = request->at;
    chunk->halves = request->format.halves;
    TRY(image_writer_read(client->image_writer, snapshot, 0, NULL, &length, &size));
    chunk->size = size;
    TRY(bulk_chunk_open(request->offset, request->length, size, payload));
    length = zmq_msg_size(payload);
    result_t result = image_writer_read(client->image_writer, snapshot, request->offset,
                                        zmq_msg_data(payload), &length, &size);
    if (result.code == RESULT_OK && length != zmq_msg_size(payload))
        result = result_fail(RESULT_IO, "the image's file is shorter than it was");
    if (result.code != RESULT_OK) zmq_msg_close(payload);
    return result;
}

static void answer_image(client_bulk_t *client, peer_server_t *server, const image_request_t *request,
                         uint64_t snapshot, result_t result)
{
    Lm__ImageChunk chunk = LM__IMAGE_CHUNK__INIT;
    zmq_msg_t payload;
    if (result.code == RESULT_OK) result = get_image(client, snapshot, request, &chunk, &payload);
    if (result.code == RESULT_OK)
        peer_send(server, &request->identity, request->request, LM__ENVELOPE__BODY_IMAGE_CHUNK, &chunk,
                  &payload);
    else
        peer_send_refusal(server, &request->identity, request->request, result);
}

static void on_image_get(void *self, peer_server_t *server, const wire_message_t *message)
{
    client_bulk_t *client = self;
    const Lm__ImageGet *get = message->envelope->image_get;
    image_request_t request = {.identity = peer_identity(message),
                               .request = message->envelope->request,
                               .job = get->job,
                               .format = {.half = get->half, .halves = get->halves},
                               .at = get->at,
                               .offset = get->offset,
                               .length = get->length,
                               .progress = get->progress};
    if (get->snapshot != 0) {
        answer_image(client, server, &request, get->snapshot, result_ok());
        return;
    }
    result_t result = image_writer_ask(client->image_writer, &request);
    if (result.code != RESULT_OK) peer_refuse(server, message, result);
}

/* Tells those who wait for images how it stands. Who cannot be told is gone, and waits no longer. */
static void send_news(client_bulk_t *client, peer_server_t *server)
{
    image_news_t news[IMAGE_WRITER_MAX_NEWS];
    if (clock_now() < client->next_news) return;
    client->next_news = clock_now() + NEWS_INTERVAL;
    size_t count = image_writer_news(client->image_writer, news);
    for (size_t i = 0; i < count; i++) {
        Lm__ImageProgress progress = LM__IMAGE_PROGRESS__INIT;
        progress.before = news[i].before;
        progress.share = news[i].share;
        if (!peer_send(server, &news[i].identity, news[i].request, LM__ENVELOPE__BODY_IMAGE_PROGRESS,
                       &progress, NULL))
            image_writer_forget(client->image_writer, &news[i].identity, news[i].request);
    }
}

/* Sends the images that were made, and news of the others. */
static void turn(void *self, peer_server_t *server, bool more)
{
    client_bulk_t *client = self;
    image_request_t request;
    result_t result;
    uint64_t snapshot;
    (void)more;
    while (image_writer_next_answer(client->image_writer, &request, &result, &snapshot))
        answer_image(client, server, &request, snapshot, result);
    send_news(client, server);
}

/* proto/serve/control_server.c says what a new kind takes. */
static const message_kind_t kinds[] = {{LM__ENVELOPE__BODY_BLOB_PUT, RIGHT_CLIENT, on_blob_put},
                                       {LM__ENVELOPE__BODY_IMAGE_GET, RIGHT_CLIENT, on_image_get}};

message_table_t client_bulk_table(client_bulk_t *client)
{
    return (message_table_t){kinds, ARRAY_LENGTH(kinds), turn, client};
}
