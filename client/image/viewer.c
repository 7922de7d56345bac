/* viewer: see viewer.h. */
#include "client/image/viewer.h"

#include "client/image/tev.h"
#include "common/address.h"

#include <errno.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

static const double FIRST_WAIT = 0.25, LONGEST_WAIT = 4.0; /* seconds between attempts; doubled each time */
static const double CONNECT_TIMEOUT = 5.0;                 /* seconds for an attempt */
static const double SETTLING = 0.3;  /* seconds: a tunnel without a viewer ends the connection in this time */
static const int SILENCE_MS = 60000; /* a machine that acknowledges nothing for so long is gone */
enum { TILES_A_STEP = 32 };          /* sent before the caller is asked again */

struct viewer {
    char *label, *name;
    struct addrinfo *addresses, *address; /* all, and the one that is tried */

    int socket; /* -1: none */
    bool connected;
    double since; /* clock: the attempt, then the connection began */
    double retry; /* clock: when the next attempt is due; 0: none has failed since the last connection */
    double wait;  /* seconds: after it, if it fails */
    uint64_t connections, sent;
    bool complete; /* a whole image went over this connection */

    image_t image;      /* on its way; width 0: none */
    const char **names; /* of its channels in the order in which they are sent; borrowed from it */
    size_t *order;      /* their indices */
    size_t tile;        /* the next one to be looked at */
    float *values;      /* of one tile, [channels][pixels] */

    hash_t layout; /* of the image that the viewer holds: size and names; zero: it holds none */
    hash_t *shown; /* [tiles][channels], what it holds; zero: nothing */
    tev_packets_t out;
    size_t out_done;

    bool told_away;
    char news[500]; /* empty: none */
};

/* ---- beginning and end -------------------------------------------------------------------------------- */

/* IPv6 addresses are in brackets only where a port may follow. */
static result_t look_up(viewer_t *viewer, address_t *address)
{
    char port[16], *host = address->host;
    snprintf(port, sizeof port, "%d", address->port);
    if (host[0] == '[') {
        host++;
        host[strlen(host) - 1] = '\0';
    }
    struct addrinfo hints = {.ai_socktype = SOCK_STREAM};
    int code = getaddrinfo(host, port, &hints, &viewer->addresses);
    if (code == 0) return result_ok();
    return result_fail(RESULT_INPUT,
                       "cannot find the image viewer's host '%s': %s; check its name, or give its IP address",
                       host, code == EAI_SYSTEM ? strerror(errno) : gai_strerror(code));
}

result_t viewer_open(const char *text, viewer_t **viewer_pointer)
{
    address_t address;
    *viewer_pointer = NULL;
    TRY(address_parse(text, TEV_DEFAULT_PORT, &address));
    viewer_t *viewer = mem_zalloc(1, sizeof *viewer);
    viewer->label = mem_printf("%s:%d", address.host, address.port);
    viewer->name = mem_strdup("lightmill");
    viewer->socket = -1;
    viewer->wait = FIRST_WAIT;
    result_t result = look_up(viewer, &address);
    viewer->address = viewer->addresses;
    if (result.code == RESULT_OK)
        *viewer_pointer = viewer;
    else
        viewer_close(&viewer);
    return result;
}

static void forget_image(viewer_t *viewer)
{
    image_free(&viewer->image);
    free(viewer->names);
    free(viewer->order);
    free(viewer->values);
    viewer->image = (image_t){0};
    viewer->names = NULL;
    viewer->order = NULL;
    viewer->values = NULL;
}

void viewer_close(viewer_t **viewer_pointer)
{
    viewer_t *viewer = *viewer_pointer;
    if (viewer == NULL) return;
    if (viewer->socket >= 0) close(viewer->socket);
    if (viewer->addresses) freeaddrinfo(viewer->addresses);
    forget_image(viewer);
    free(viewer->shown);
    free(viewer->out.bytes);
    free(viewer->label);
    free(viewer->name);
    free(viewer);
    *viewer_pointer = NULL;
}

void viewer_name(viewer_t *viewer, const char *name)
{
    free(viewer->name);
    viewer->name = mem_strdup(name);
}

/* ---- what is told ------------------------------------------------------------------------------------- */

static void tell_away(viewer_t *viewer, const char *why)
{
    if (viewer->told_away) return;
    viewer->told_away = true;
    if (viewer->complete)
        snprintf(viewer->news, sizeof viewer->news, "the image viewer at %s is gone (%s); trying on",
                 viewer->label, why);
    else
        snprintf(
            viewer->news, sizeof viewer->news,
            "no image viewer answers at %s (%s); start tev there, or HDRView as a display server; one on "
            "another machine is reached through: ssh -L or -R %d:localhost:%d; trying on",
            viewer->label, why, TEV_DEFAULT_PORT, TEV_DEFAULT_PORT);
}

static void tell_complete(viewer_t *viewer)
{
    if (viewer->told_away)
        snprintf(viewer->news, sizeof viewer->news, "the image viewer at %s is there", viewer->label);
    viewer->told_away = false;
}

bool viewer_news(viewer_t *viewer, char text[500])
{
    if (viewer->news[0] == '\0') return false;
    memcpy(text, viewer->news, sizeof viewer->news);
    viewer->news[0] = '\0';
    return true;
}

/* ---- the connection ----------------------------------------------------------------------------------- */

/* Ends the connection or the attempt. What was on its way is lost: the next viewer gets another image. */
static void lose(viewer_t *viewer, const char *why)
{
    tell_away(viewer, why);
    if (viewer->socket >= 0) close(viewer->socket);
    viewer->socket = -1;
    viewer->connected = viewer->complete = false;
    viewer->address = viewer->addresses;
    viewer->retry = clock_now() + viewer->wait;
    viewer->wait = 2 * viewer->wait < LONGEST_WAIT ? 2 * viewer->wait : LONGEST_WAIT;
    viewer->layout = (hash_t){0};
    viewer->out.size = viewer->out_done = 0;
    forget_image(viewer);
}

/* Begins an attempt at one address; 0 or an errno. What becomes of it, poll tells. */
static int dial_address(viewer_t *viewer)
{
    const struct addrinfo *address = viewer->address;
    int on = 1;
    viewer->since = clock_now();
    viewer->socket = socket(address->ai_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    if (viewer->socket < 0) return errno;
    setsockopt(viewer->socket, SOL_SOCKET, SO_KEEPALIVE, &on, sizeof on);
    setsockopt(viewer->socket, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    setsockopt(viewer->socket, IPPROTO_TCP, TCP_USER_TIMEOUT, &SILENCE_MS, sizeof SILENCE_MS);
    if (connect(viewer->socket, address->ai_addr, address->ai_addrlen) == 0) return 0;
    return errno == EINPROGRESS ? 0 : errno;
}

/* Begins an attempt at this address, or, after the error of one, at the next: a host may have several
 * ("localhost" has two), and the viewer listens at one of them. */
static void dial(viewer_t *viewer, int error)
{
    for (;;) {
        if (error == 0) error = dial_address(viewer);
        if (error == 0) return;
        if (viewer->address->ai_next == NULL) break;
        if (viewer->socket >= 0) close(viewer->socket);
        viewer->address = viewer->address->ai_next;
        error = 0;
    }
    lose(viewer, strerror(error));
}

static void see_attempt(viewer_t *viewer, short events)
{
    int error = 0;
    socklen_t size = sizeof error;
    bool late = clock_now() - viewer->since > CONNECT_TIMEOUT;
    if (events == 0 && !late) return;
    getsockopt(viewer->socket, SOL_SOCKET, SO_ERROR, &error, &size);
    if (error != 0 || late) {
        dial(viewer, error ? error : ETIMEDOUT);
        return;
    }
    viewer->connected = true;
    viewer->retry = 0;
    viewer->since = clock_now();
    viewer->connections++;
}

/* A viewer says nothing, so what comes is thrown away, but for the end. */
static void see_end(viewer_t *viewer)
{
    char waste[4096];
    ssize_t length = recv(viewer->socket, waste, sizeof waste, MSG_DONTWAIT);
    if (length == 0)
        lose(viewer, "it closed the connection");
    else if (length < 0 && errno != EAGAIN && errno != EINTR)
        lose(viewer, strerror(errno));
}

uint64_t viewer_connection(const viewer_t *viewer)
{
    return viewer->connected && clock_now() - viewer->since > SETTLING ? viewer->connections : 0;
}

bool viewer_away(const viewer_t *viewer)
{
    return !viewer->connected && viewer->retry > 0;
}

uint64_t viewer_sent(const viewer_t *viewer)
{
    return viewer->sent;
}

const char *viewer_label(const viewer_t *viewer)
{
    return viewer->label;
}

bool viewer_idle(const viewer_t *viewer)
{
    return viewer->image.width == 0 && viewer->out_done == viewer->out.size;
}

/* ---- the image ---------------------------------------------------------------------------------------- */

/* The picture comes first, then the layers as the file has them. */
static void order_channels(viewer_t *viewer)
{
    const image_t *image = &viewer->image;
    const image_channel_t *rgb[3];
    size_t count = 0;
    viewer->order = mem_zalloc(image->channel_count, sizeof *viewer->order);
    viewer->names = mem_zalloc(image->channel_count, sizeof *viewer->names);
    bool picture = image_find_rgb(image, NULL, rgb);
    if (picture)
        for (int c = 0; c < 3; c++) viewer->order[count++] = (size_t)(rgb[c] - image->channels);
    for (size_t c = 0; c < image->channel_count; c++) {
        const image_channel_t *channel = &image->channels[c];
        if (picture && (channel == rgb[0] || channel == rgb[1] || channel == rgb[2])) continue;
        viewer->order[count++] = c;
    }
    for (size_t c = 0; c < count; c++) viewer->names[c] = image->channels[viewer->order[c]].name;
}

static size_t tiles_across(int pixels)
{
    return ((size_t)pixels + VIEWER_TILE - 1) / VIEWER_TILE;
}

static size_t tile_count(const image_t *image)
{
    return tiles_across(image->width) * tiles_across(image->height);
}

/* A hash of the CreateImage that makes it: images with the same one can be updated. */
static void create_unless_held(viewer_t *viewer)
{
    const image_t *image = &viewer->image;
    size_t before = viewer->out.size;
    tev_create_image(&viewer->out, viewer->name, image->width, image->height, viewer->names,
                     image->channel_count);
    hash_t layout = hash_bytes(viewer->out.bytes + before, viewer->out.size - before);
    if (hash_equal(&layout, &viewer->layout)) {
        viewer->out.size = before;
        return;
    }
    viewer->layout = layout;
    free(viewer->shown);
    viewer->shown = mem_zalloc(tile_count(image) * image->channel_count, sizeof *viewer->shown);
}

void viewer_show(viewer_t *viewer, image_t *image)
{
    forget_image(viewer);
    if (!viewer->connected) {
        image_free(image);
        return;
    }
    viewer->image = *image;
    *image = (image_t){0};
    viewer->tile = 0;
    viewer->values =
        mem_alloc(viewer->image.channel_count * VIEWER_TILE * VIEWER_TILE * sizeof *viewer->values);
    order_channels(viewer);
    create_unless_held(viewer);
}

static tev_rectangle_t tile_rectangle(const image_t *image, size_t tile)
{
    int x = (int)(tile % tiles_across(image->width)) * VIEWER_TILE;
    int y = (int)(tile / tiles_across(image->width)) * VIEWER_TILE;
    return (tev_rectangle_t){x, y, int_min(VIEWER_TILE, image->width - x),
                             int_min(VIEWER_TILE, image->height - y)};
}

static void copy_channel(const image_t *image, const image_channel_t *channel,
                         const tev_rectangle_t *rectangle, float *values)
{
    for (int y = rectangle->y; y < rectangle->y + rectangle->height; y++) {
        const float *row = channel->data + (size_t)y * (size_t)image->width * channel->stride;
        for (int x = rectangle->x; x < rectangle->x + rectangle->width; x++)
            *values++ = row[(size_t)x * channel->stride];
    }
}

/* Queues the channels of a tile that changed since they were sent. */
static void queue_tile(viewer_t *viewer, size_t tile)
{
    const image_t *image = &viewer->image;
    tev_rectangle_t rectangle = tile_rectangle(image, tile);
    size_t plane = (size_t)rectangle.width * (size_t)rectangle.height, count = 0;
    const char *changed[IMAGE_MAX_CHANNELS];
    for (size_t c = 0; c < image->channel_count; c++) {
        float *values = viewer->values + count * plane;
        copy_channel(image, &image->channels[viewer->order[c]], &rectangle, values);
        hash_t hash = hash_bytes(values, plane * sizeof *values);
        hash_t *shown = &viewer->shown[tile * image->channel_count + c];
        if (hash_equal(&hash, shown)) continue;
        *shown = hash;
        changed[count++] = viewer->names[c];
    }
    if (count > 0) tev_update_image(&viewer->out, viewer->name, &rectangle, changed, count, viewer->values);
}

/* Queues the next tile that has something to send; afterwards the image is not needed any more. */
static void queue_more(viewer_t *viewer)
{
    if (viewer->out_done < viewer->out.size) return;
    viewer->out.size = viewer->out_done = 0;
    while (viewer->image.width > 0 && viewer->out.size == 0) {
        if (viewer->tile < tile_count(&viewer->image)) {
            queue_tile(viewer, viewer->tile++);
            continue;
        }
        forget_image(viewer);
        viewer->complete = true;
        viewer->wait = FIRST_WAIT;
        tell_complete(viewer);
    }
}

/* Returns false when the system takes no more now, or there is nothing. */
static bool send_some(viewer_t *viewer)
{
    queue_more(viewer);
    if (viewer->out_done == viewer->out.size) return false;
    ssize_t length = send(viewer->socket, viewer->out.bytes + viewer->out_done,
                          viewer->out.size - viewer->out_done, MSG_NOSIGNAL | MSG_DONTWAIT);
    if (length >= 0) {
        viewer->out_done += (size_t)length;
        viewer->sent += (uint64_t)length;
        return true;
    }
    if (errno != EAGAIN && errno != EINTR) lose(viewer, strerror(errno));
    return false;
}

static void pause_for(double seconds)
{
    if (seconds <= 0) return;
    struct timespec time = {.tv_sec = (time_t)seconds};
    time.tv_nsec = (long)(1e9 * (seconds - (double)time.tv_sec));
    nanosleep(&time, NULL);
}

void viewer_step(viewer_t *viewer, double seconds)
{
    if (viewer->socket < 0) {
        double left = viewer->retry - clock_now();
        pause_for(left < seconds ? left : seconds);
        if (clock_now() >= viewer->retry) dial(viewer, 0);
        return;
    }
    bool writes = !viewer->connected || !viewer_idle(viewer);
    struct pollfd item = {.fd = viewer->socket, .events = (short)(POLLIN | (writes ? POLLOUT : 0))};
    if (poll(&item, 1, (int)(1000 * seconds)) < 0) return;
    if (!viewer->connected) {
        see_attempt(viewer, item.revents);
        return;
    }
    if (item.revents & (POLLIN | POLLHUP | POLLERR)) see_end(viewer);
    for (int i = 0; i < TILES_A_STEP && viewer->socket >= 0; i++)
        if (!send_some(viewer)) return;
}
