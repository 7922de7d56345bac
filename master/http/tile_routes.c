/* tile_routes: the answer to who watches an image: tiles.h by HTTP. */
#include "master/http/routes.h"
#include "master/http/server_state.h"

#include <stdlib.h>

/* What the query says; a rectangle is the whole image where it does not. */
static result_t read_query(const http_request_t *request, layer_t *layer, tile_query_t *query)
{
    const char *name = http_query(request, "layer");
    *layer = LAYER_PICTURE;
    if (name != NULL && !layer_parse(name, layer)) {
        char *names = layer_names();
        result_t failure = result_fail(RESULT_USAGE, "layer is %s, not '%.60s'", names, name);
        free(names);
        return failure;
    }
    const struct {
        const char *name;
        uint64_t most, missing;
    } numbers[] = {{"level", PYRAMID_MAX_LEVELS - 1, 0},
                   {"since", UINT32_MAX, 0},
                   {"x0", JOB_MAX_RESOLUTION, 0},
                   {"y0", JOB_MAX_RESOLUTION, 0},
                   {"x1", JOB_MAX_RESOLUTION, JOB_MAX_RESOLUTION},
                   {"y1", JOB_MAX_RESOLUTION, JOB_MAX_RESOLUTION}};
    uint64_t values[ARRAY_LENGTH(numbers)];
    for (size_t i = 0; i < ARRAY_LENGTH(numbers); i++)
        TRY(http_query_number(request, numbers[i].name, 0, numbers[i].most, numbers[i].missing, &values[i]));
    *query = (tile_query_t){
        .level = (uint32_t)values[0],
        .since = (uint32_t)values[1],
        .rect = {(int32_t)values[2], (int32_t)values[3], (int32_t)values[4], (int32_t)values[5]}};
    return result_ok();
}

/* An answer that is being sent. */
typedef struct {
    tiles_t *tiles;
    uint8_t *bytes;
    size_t size;
} sent_t;

static void on_sent(void *context)
{
    sent_t *sent = context;
    tiles_release(sent->tiles, sent->bytes, sent->size);
    free(sent);
}

static void send_tiles(http_request_t *request, uint8_t *bytes, size_t size)
{
    sent_t *sent = mem_alloc(sizeof *sent);
    *sent = (sent_t){request->server->tiles, bytes, size};
    struct MHD_Response *response =
        MHD_create_response_from_buffer_with_free_callback_cls(size, bytes, on_sent, sent);
    if (response == NULL) on_sent(sent);
    http_reply_response(request, MHD_HTTP_OK, "application/octet-stream", response);
}

static void reply_tiles(http_request_t *request, const result_t *result, uint8_t *bytes, size_t size)
{
    if (result->code == RESULT_UNREACHABLE)
        http_reply_no_job(request, request->numbers[0]);
    else if (result->code != RESULT_OK)
        http_reply_failure(request, result);
    else
        send_tiles(request, bytes, size);
}

/* What was asked was right when the request was put aside; its turn has come, or has not come in time. */
static void show_tiles_in_turn(http_request_t *request)
{
    layer_t layer;
    tile_query_t query;
    uint8_t *bytes = NULL;
    size_t size = 0;
    tiles_t *tiles = request->server->tiles;
    uint64_t job = request->numbers[0];
    result_t result = read_query(request, &layer, &query);
    if (request->value == 0) tiles_note_wait(tiles);
    if (result.code == RESULT_OK && request->value == 0)
        result = tiles_get_nothing(tiles, job, &query, &bytes, &size);
    else if (result.code == RESULT_OK)
        result = tiles_get(tiles, job, layer, &query, &bytes, &size);
    if (result.code == RESULT_OK) pace_sent(request->server->pace, size, true);
    reply_tiles(request, &result, bytes, size);
}

static void show_tiles(http_request_t *request)
{
    layer_t layer;
    tile_query_t query;
    uint8_t *bytes = NULL;
    size_t size = 0;
    http_server_t *server = request->server;
    result_t result = read_query(request, &layer, &query);
    if (result.code == RESULT_OK && !pace_may_send(server->pace, query.since == 0) &&
        tiles_newer(server->tiles, request->numbers[0], layer, &query)) {
        pace_wait(server->pace, request, show_tiles_in_turn);
        return;
    }
    if (result.code == RESULT_OK)
        result = tiles_get(server->tiles, request->numbers[0], layer, &query, &bytes, &size);
    if (result.code == RESULT_OK) pace_sent(server->pace, size, false);
    reply_tiles(request, &result, bytes, size);
}

static const http_route_t routes[] = {{"GET", "/api/v1/jobs/#/tiles", HTTP_VIEW, show_tiles}};
const http_table_t http_tile_routes = {routes, ARRAY_LENGTH(routes)};
