/* animation: what moves nodes and morph targets at a time (the glTF 2.0 specification, section 3.11 and
 * appendix C).
 *
 * Keys are looked up where they are wanted, so that work does not grow with their number.
 */
#include "client/import/gltf/document.h"

#include <inttypes.h>
#include <stdlib.h>
#include <string.h>

typedef enum { INTERPOLATE_LINEAR, INTERPOLATE_STEP, INTERPOLATE_CUBIC } interpolation_t;

/* One property of one node over time. */
typedef struct {
    moving_t property;
    interpolation_t interpolation;
    accessor_t times, values;
    size_t width;  /* numbers that a key gives */
    uint32_t next; /* the node's next channel, or ITEM_NONE */
} track_t;

struct animation {
    track_t *channels;
    size_t count, capacity;
    uint32_t *firsts; /* [nodes]: the first channel of each, or ITEM_NONE */
};

static const struct {
    const char *path;
    size_t width; /* 0: as many as the mesh has targets */
} properties[MOVING_COUNT] = {[MOVING_TRANSLATION] = {"translation", 3},
                              [MOVING_ROTATION] = {"rotation", 4},
                              [MOVING_SCALE] = {"scale", 3},
                              [MOVING_WEIGHTS] = {"weights", 0}};

/* ---- reading ------------------------------------------------------------------------------------------- */

static track_t *find(const document_t *document, uint32_t node, moving_t property)
{
    struct animation *animation = document->animation;
    for (uint32_t i = animation ? animation->firsts[node] : ITEM_NONE; i != ITEM_NONE;
         i = animation->channels[i].next)
        if (animation->channels[i].property == property) return &animation->channels[i];
    return NULL;
}

/* What a channel moves; *node is ITEM_NONE when that is nothing that is known here. */
static result_t read_target(const document_t *document, const item_t *channel, uint32_t *node,
                            moving_t *property)
{
    item_t target;
    const char *path = "";
    *node = ITEM_NONE;
    TRY(item_member(channel, "target", JSON_OBJECT, &target));
    TRY(item_string(&target, "path", &path));
    for (int i = 0; i < MOVING_COUNT; ++i) {
        if (strcmp(path, properties[i].path) != 0) continue;
        *property = (moving_t)i;
        return item_index(&target, "node", document_count(document, TOP_NODES), node);
    }
    return result_ok();
}

static result_t read_interpolation(const item_t *sampler, interpolation_t *interpolation)
{
    static const char *const names[] = {
        [INTERPOLATE_LINEAR] = "LINEAR", [INTERPOLATE_STEP] = "STEP", [INTERPOLATE_CUBIC] = "CUBICSPLINE"};
    const char *name = names[0];
    TRY(item_string(sampler, "interpolation", &name));
    for (size_t i = 0; i < ARRAY_LENGTH(names); ++i) {
        if (strcmp(name, names[i]) != 0) continue;
        *interpolation = (interpolation_t)i;
        return result_ok();
    }
    return item_fail(sampler, "its interpolation must be LINEAR, STEP or CUBICSPLINE, found \"%.20s\"", name);
}

/* Elements of a key: of a spline the tangent into it, its value, the tangent out of it. */
static size_t parts(const track_t *channel)
{
    return channel->interpolation == INTERPOLATE_CUBIC ? 3 : 1;
}

static result_t open_sampler(document_t *document, const item_t *sampler, track_t *channel)
{
    uint32_t times = ITEM_NONE, values = ITEM_NONE;
    size_t accessors = document_count(document, TOP_ACCESSORS), least = properties[channel->property].width;
    TRY(read_interpolation(sampler, &channel->interpolation));
    TRY(item_index(sampler, "input", accessors, &times));
    TRY(item_index(sampler, "output", accessors, &values));
    if (times == ITEM_NONE || values == ITEM_NONE) return item_fail(sampler, "needs input and output");
    TRY(accessor_open(document, times, &channel->times));
    TRY(accessor_open(document, values, &channel->values));
    if (channel->times.components != 1 || channel->times.type != COMPONENT_FLOAT)
        return item_fail(sampler, "its input (accessor %" PRIu32 ") must be SCALAR floats", times);
    if (channel->values.components != (least ? least : 1))
        return item_fail(sampler, "its output (accessor %" PRIu32 ") has the wrong number of components",
                         values);
    size_t elements = channel->times.count * parts(channel);
    channel->width = least ? least : channel->values.count / elements;
    if (channel->values.count < elements)
        return item_fail(sampler, "has %zu values for %zu keys", channel->values.count, channel->times.count);
    return result_ok();
}

static result_t read_channel(document_t *document, const item_t *animation, const item_t *item)
{
    item_t samplers, sampler;
    uint32_t node, index = ITEM_NONE;
    track_t channel = {.next = ITEM_NONE};
    struct animation *all = document->animation;
    TRY(read_target(document, item, &node, &channel.property));
    if (node == ITEM_NONE) {
        item_warn(item, "moves no node; it is ignored");
        return result_ok();
    }
    if (find(document, node, channel.property)) return result_ok();
    TRY(item_member(animation, "samplers", JSON_ARRAY, &samplers));
    TRY(item_index(item, "sampler", item_count(&samplers), &index));
    if (index == ITEM_NONE) return item_fail(item, "names no sampler");
    TRY(item_element(&samplers, index, JSON_OBJECT, &sampler));
    TRY(open_sampler(document, &sampler, &channel));
    channel.next = all->firsts[node];
    all->firsts[node] = (uint32_t)all->count;
    all->channels = grow(all->channels, &all->capacity, all->count + 1, sizeof *all->channels);
    all->channels[all->count++] = channel;
    return result_ok();
}

static result_t read_animation(document_t *document, const item_t *item)
{
    item_t channels, channel;
    TRY(item_member(item, "channels", JSON_ARRAY, &channels));
    for (size_t i = 0; i < item_count(&channels); ++i) {
        TRY(item_element(&channels, i, JSON_OBJECT, &channel));
        TRY(read_channel(document, item, &channel));
    }
    return result_ok();
}

/* ---- which ones ---------------------------------------------------------------------------------------- */

/* Whether it moves what one that was read moves already. */
static result_t meets_another(const document_t *document, const item_t *item, bool *meets)
{
    item_t channels, channel;
    *meets = false;
    TRY(item_member(item, "channels", JSON_ARRAY, &channels));
    for (size_t i = 0; i < item_count(&channels); ++i) {
        uint32_t node;
        moving_t property = MOVING_TRANSLATION;
        TRY(item_element(&channels, i, JSON_OBJECT, &channel));
        TRY(read_target(document, &channel, &node, &property));
        *meets = *meets || (node != ITEM_NONE && find(document, node, property));
    }
    return result_ok();
}

/* All animations but those that move what one before them moves. */
static result_t read_together(document_t *document)
{
    const item_t *animations = &document->tops[TOP_ANIMATIONS];
    char first[PATH_ROOM] = "";
    size_t left = 0;
    for (size_t i = 0; i < item_count(animations); ++i) {
        item_t item;
        bool meets;
        TRY(item_element(animations, i, JSON_OBJECT, &item));
        TRY(meets_another(document, &item, &meets));
        if (!meets) {
            TRY(read_animation(document, &item));
        } else if (left++ == 0) {
            item_name(&item, first, sizeof first);
        }
    }
    if (left > 0)
        item_warn(
            animations,
            "%zu of %zu (%s%s) move what one before them moves, and are left out; --animation takes one",
            left, item_count(animations), first, left > 1 ? ", ..." : "");
    return result_ok();
}

/* The animation of a name, else of a number from 1. */
static result_t read_one(document_t *document, const char *wanted)
{
    size_t count = document_count(document, TOP_ANIMATIONS), index = 0;
    item_t item;
    while (index < count && !document_is_named(document, TOP_ANIMATIONS, (uint32_t)index, wanted)) ++index;
    if (index == count && !wishes_number(wanted, count, &index)) {
        char list[ITEM_LIST_ROOM];
        TRY(item_list_names(&document->tops[TOP_ANIMATIONS], list));
        return result_fail(RESULT_USAGE, "--animation: the scene has no animation '%.100s'; it has %zu%s%s",
                           wanted, count, list[0] ? ": " : "", list);
    }
    TRY(document_item(document, TOP_ANIMATIONS, (uint32_t)index, &item));
    return read_animation(document, &item);
}

/* "SECONDS", half of them before the moment and half after, or "OPEN,CLOSE", from the moment on. */
static result_t read_shutter(const char *text, double *open, double *close)
{
    static const double longest = 1e9;
    char *end;
    *open = strtod(text, &end);
    bool both = *end == ',';
    *close = both ? strtod(end + 1, &end) : *open / 2;
    if (!both) *open = -*close;
    if (*end == '\0' && *open < *close && *open >= -longest && *close <= longest) return result_ok();
    return result_fail(
        RESULT_USAGE,
        "--shutter takes SECONDS above 0, or OPEN,CLOSE in seconds, OPEN below CLOSE, not '%.60s'", text);
}

/* The times of the poses. Where nothing moves, one is enough. */
static result_t open_shutter(document_t *document, const import_wishes_t *wishes)
{
    double moment = wishes_moment(wishes), open = 0, close = 0;
    if (wishes->shutter) TRY(read_shutter(wishes->shutter, &open, &close));
    document->pose_count = open < close && document->animation->count > 0 ? MOST_POSES : 1;
    document->pose = &document->poses[document->pose_count / 2];
    double last = (double)MOST_POSES - 1;
    for (size_t i = 0; i < document->pose_count; ++i)
        document->poses[i].time = moment + open + (close - open) * (double)i / last;
    return result_ok();
}

result_t animation_open(document_t *document)
{
    const import_wishes_t *wishes = document->builder->report->sink.wishes;
    const item_t *animations = &document->tops[TOP_ANIMATIONS];
    if (!wishes || !wishes_have_moment(wishes)) {
        if (item_count(animations) > 0)
            item_warn(animations, "are ignored: everything stands as the nodes say; --time-point or --frame "
                                  "takes a moment");
        return result_ok();
    }
    if (item_count(animations) == 0 && !wishes->animation)
        item_warn(&document->root, "has no animations: it is the same at every time");
    size_t nodes = document_count(document, TOP_NODES);
    document->animation = mem_zalloc(1, sizeof *document->animation);
    document->animation->firsts = mem_alloc((nodes + 1) * sizeof *document->animation->firsts);
    for (size_t i = 0; i < nodes; ++i) document->animation->firsts[i] = ITEM_NONE;
    TRY(wishes->animation ? read_one(document, wishes->animation) : read_together(document));
    return open_shutter(document, wishes);
}

void animation_close(document_t *document)
{
    if (!document->animation) return;
    free(document->animation->channels);
    free(document->animation->firsts);
    free(document->animation);
    document->animation = NULL;
}

/* ---- a moment ------------------------------------------------------------------------------------------ */

static double time_of(const track_t *channel, size_t key)
{
    double time = 0;
    accessor_get(&channel->times, key, &time);
    return time;
}

/* The last key that is not after the time, or the first. */
static size_t find_key(const track_t *channel, double time)
{
    size_t low = 0, high = channel->times.count;
    while (high - low > 1) {
        size_t middle = low + (high - low) / 2;
        if (time_of(channel, middle) <= time)
            low = middle;
        else
            high = middle;
    }
    return low;
}

static double number_of(const track_t *channel, size_t key, size_t part, size_t i)
{
    double values[4] = {0};
    size_t element = key * parts(channel) + part;
    if (channel->property == MOVING_WEIGHTS) {
        accessor_get(&channel->values, element * channel->width + i, values);
        return values[0];
    }
    accessor_get(&channel->values, element, values);
    return values[i];
}

/* Along the great arc between two unit quaternions (appendix C.5), the shorter one. */
static void slerp(const track_t *channel, size_t key, double u, double out[4])
{
    double a[4], b[4], dot = 0;
    for (size_t i = 0; i < 4; ++i) {
        a[i] = number_of(channel, key, 0, i);
        b[i] = number_of(channel, key + 1, 0, i);
        dot += a[i] * b[i];
    }
    double angle = acos(fmin(fabs(dot), 1)), sine = sin(angle);
    for (size_t i = 0; i < 4; ++i) {
        if (dot < 0) b[i] = -b[i];
        out[i] = sine > 1e-6 ? (sin((1 - u) * angle) * a[i] + sin(u * angle) * b[i]) / sine
                             : a[i] + u * (b[i] - a[i]);
    }
}

/* A cubic spline between keys that lie `step` seconds apart (appendix C.4). */
static double spline(const track_t *channel, size_t key, size_t i, double u, double step)
{
    double u2 = u * u, u3 = u2 * u;
    return (2 * u3 - 3 * u2 + 1) * number_of(channel, key, 1, i) +
           step * (u3 - 2 * u2 + u) * number_of(channel, key, 2, i) +
           (3 * u2 - 2 * u3) * number_of(channel, key + 1, 1, i) +
           step * (u3 - u2) * number_of(channel, key + 1, 0, i);
}

/* Between a key and the next, a share u of the way. */
static void interpolate(const track_t *channel, size_t key, double u, double step, double *out, size_t count)
{
    if (channel->property == MOVING_ROTATION && channel->interpolation == INTERPOLATE_LINEAR) {
        slerp(channel, key, u, out);
        return;
    }
    for (size_t i = 0; i < count; ++i) {
        double a = number_of(channel, key, 0, i);
        out[i] = channel->interpolation == INTERPOLATE_CUBIC
                     ? spline(channel, key, i, u, step)
                     : a + u * (number_of(channel, key + 1, 0, i) - a);
    }
}

size_t animation_width(const document_t *document, uint32_t node, moving_t property)
{
    const track_t *channel = find(document, node, property);
    return channel ? channel->width : 0;
}

result_t animation_value(const document_t *document, uint32_t node, moving_t property, double time,
                         double *values)
{
    const track_t *channel = find(document, node, property);
    if (!channel) return result_ok();
    size_t key = find_key(channel, time), value = channel->interpolation == INTERPOLATE_CUBIC ? 1 : 0;
    double begin = time_of(channel, key), step = 0;
    if (key + 1 < channel->times.count) step = time_of(channel, key + 1) - begin;
    bool between = step > 0 && time > begin && channel->interpolation != INTERPOLATE_STEP;
    if (between) interpolate(channel, key, (time - begin) / step, step, values, channel->width);
    bool finite = true;
    for (size_t i = 0; i < channel->width; ++i) {
        if (!between) values[i] = number_of(channel, key, value, i);
        finite = finite && isfinite(values[i]);
    }
    if (finite) return result_ok();
    item_t item;
    TRY(document_item(document, TOP_NODES, node, &item));
    return item_fail(&item, "its animated %s is not finite at %g seconds", properties[property].path, time);
}
