/* mixture: see mixture.h. */
#include "client/image/mixture.h"

#include "common/film/picture.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char *const part_names[MIXTURE_PARTS] = {"eye", "light"};
static const double MAX_FACTOR = 1e6;

/* ---- groups -------------------------------------------------------------------------------------------- */

/* The group of a channel "group.NAME.PART.COLOUR", with its part and colour; false for any other channel, and
 * for names that do things to a terminal on which they are shown. */
static bool parse_channel(const char *channel, char name[64], int *part, int *colour)
{
    char part_name[8], last[2];
    int used = 0;
    if (sscanf(channel, "group.%63[^.\001-\037\177].%7[^.].%1[RGB]%n", name, part_name, last, &used) != 3 ||
        channel[used] != '\0')
        return false;
    for (*part = 0; *part < MIXTURE_PARTS && strcmp(part_names[*part], part_name) != 0;) ++*part;
    *colour = last[0] == 'R' ? 0 : last[0] == 'G' ? 1 : 2;
    return *part < MIXTURE_PARTS;
}

static mixture_group_t *find_group(mixture_t *mixture, const char *name, size_t size)
{
    for (size_t g = 0; g < mixture->count; g++)
        if (strlen(mixture->groups[g].name) == size && memcmp(mixture->groups[g].name, name, size) == 0)
            return &mixture->groups[g];
    return NULL;
}

static mixture_group_t *add_group(mixture_t *mixture, const char *name)
{
    mixture_group_t *group = find_group(mixture, name, strlen(name));
    if (group != NULL || mixture->count == MIXTURE_MAX_GROUPS) return group;
    group = &mixture->groups[mixture->count++];
    *group = (mixture_group_t){.factor = {1, 1, 1}};
    snprintf(group->name, sizeof group->name, "%s", name);
    return group;
}

/* A part of a group has all three colours, or counts as missing. */
static void drop_incomplete(mixture_group_t *group)
{
    for (int p = 0; p < MIXTURE_PARTS; p++) {
        bool whole = true;
        for (int c = 0; c < 3; c++) whole = whole && group->parts[p][c] != NULL;
        if (!whole) memset(group->parts[p], 0, sizeof group->parts[p]);
    }
}

result_t mixture_of(const image_t *image, const char *path, mixture_t *mixture)
{
    *mixture = (mixture_t){.image = image};
    for (size_t i = 0; i < image->channel_count; i++) {
        char name[64];
        int part, colour;
        if (!parse_channel(image->channels[i].name, name, &part, &colour)) continue;
        mixture_group_t *group = add_group(mixture, name);
        if (group == NULL)
            return result_fail(RESULT_LIMIT, "%.300s: has more than %d light groups", path,
                               MIXTURE_MAX_GROUPS);
        group->parts[part][colour] = &image->channels[i];
    }
    for (size_t g = 0; g < mixture->count; g++) drop_incomplete(&mixture->groups[g]);
    const image_channel_t *rgb[3];
    if (mixture->count > 0 && image_find_rgb(image, NULL, rgb)) return result_ok();
    return result_fail(RESULT_INPUT, "%.300s: has no light groups; render it with --light-groups", path);
}

/* ---- factors ------------------------------------------------------------------------------------------- */

static result_t no_group(const mixture_t *mixture, const char *name, size_t size)
{
    char list[300];
    size_t used = 0;
    for (size_t g = 0; g < mixture->count && used < sizeof list; g++)
        used += (size_t)snprintf(list + used, sizeof list - used, "%s%s", g > 0 ? ", " : "",
                                 mixture->groups[g].name);
    return result_fail(RESULT_USAGE, "the image has no light group '%.*s'; it has %s",
                       (int)(size < 64 ? size : 64), name, list);
}

/* One number, or three with commas between; false when it is neither. */
static bool parse_factors(const char *text, double factor[3])
{
    int count = 0;
    for (const char *at = text; count < 3;) {
        char *end;
        double value = strtod(at, &end);
        if (end == at || !(value >= 0 && value <= MAX_FACTOR)) return false;
        factor[count++] = value;
        if (*end == '\0') break;
        if (*end != ',') return false;
        at = end + 1;
        if (count == 3) return false;
    }
    for (int c = 1; c < 3 && count == 1; c++) factor[c] = factor[0];
    return count != 2;
}

result_t mixture_set(mixture_t *mixture, const char *text)
{
    const char *equals = strchr(text, '=');
    if (equals == NULL)
        return result_fail(RESULT_USAGE, "'%.100s' sets no light group: write GROUP=FACTOR or GROUP=R,G,B",
                           text);
    size_t size = (size_t)(equals - text);
    mixture_group_t *group = find_group(mixture, text, size);
    if (group == NULL) return no_group(mixture, text, size);
    if (group->set) return result_fail(RESULT_USAGE, "the light group '%s' is set twice", group->name);
    if (!parse_factors(equals + 1, group->factor))
        return result_fail(
            RESULT_USAGE,
            "the light group '%s' takes a factor or three for red, green and blue, from 0 to %g, "
            "such as 0.5 or 1,0.8,0.6, not '%.100s'",
            group->name, MAX_FACTOR, equals + 1);
    group->set = true;
    return result_ok();
}

result_t mixture_solo(mixture_t *mixture, const char *name)
{
    const mixture_group_t *solo = find_group(mixture, name, strlen(name));
    if (solo == NULL) return no_group(mixture, name, strlen(name));
    for (size_t g = 0; g < mixture->count; g++) {
        mixture_group_t *group = &mixture->groups[g];
        if (group != solo && group->set)
            return result_fail(RESULT_USAGE, "--solo %s puts out the light group '%s', which is set too",
                               name, group->name);
        if (group != solo) memset(group->factor, 0, sizeof group->factor);
    }
    return result_ok();
}

/* ---- the image ----------------------------------------------------------------------------------------- */

/* True when every group counts as it was rendered. */
static bool is_plain(const mixture_t *mixture)
{
    bool plain = true;
    for (size_t g = 0; g < mixture->count; g++)
        for (int c = 0; c < 3; c++) plain = plain && mixture->groups[g].factor[c] == 1;
    return plain;
}

/* What the groups have of a part and a colour at a pixel. */
static double mix_pixel(const mixture_t *mixture, int part, int colour, size_t pixel)
{
    double sum = 0;
    for (size_t g = 0; g < mixture->count; g++) {
        const image_channel_t *channel = mixture->groups[g].parts[part][colour];
        if (channel != NULL && mixture->groups[g].factor[colour] > 0)
            sum += mixture->groups[g].factor[colour] * (double)channel->data[pixel * channel->stride];
    }
    return sum;
}

static result_t mix_channels(const mixture_t *mixture, pixel_type_t type, image_t *mixed)
{
    size_t pixels = (size_t)mixed->width * (size_t)mixed->height;
    float *whole[3], *parts[MIXTURE_PARTS][3];
    bool room = image_add_rgb(mixed, NULL, type, whole);
    for (int p = 0; p < MIXTURE_PARTS; p++)
        room = room && image_add_rgb(mixed, part_names[p], type, parts[p]);
    if (!room)
        return result_fail(RESULT_LIMIT, "no memory for an image of %d x %d", mixed->width, mixed->height);
    for (int c = 0; c < 3; c++)
        for (size_t i = 0; i < pixels; i++) {
            double sum = 0;
            for (int p = 0; p < MIXTURE_PARTS; p++) {
                double value = mix_pixel(mixture, p, c, i);
                parts[p][c][i] = (float)value;
                sum += value;
            }
            whole[c][i] = (float)sum;
        }
    return result_ok();
}

/* Channels whose values depend on the lights. */
static bool is_lit(const char *channel)
{
    static const char *const layers[] = {"eye.", "light.", "noise.", "half0.", "half1.", "group."};
    bool lit = strlen(channel) == 1;
    for (size_t i = 0; i < ARRAY_LENGTH(layers); i++)
        lit = lit || strncmp(channel, layers[i], strlen(layers[i])) == 0;
    return lit;
}

static bool is_picture(const char *channel)
{
    return strlen(channel) == 1 || strncmp(channel, "eye.", 4) == 0 || strncmp(channel, "light.", 6) == 0;
}

/* The error is of the picture that was rendered. */
static void copy_attributes(const image_t *image, bool plain, image_t *mixed)
{
    for (size_t i = 0; i < image->attribute_count; i++) {
        const image_attribute_t *a = &image->attributes[i];
        bool ours = strncmp(a->name, "lightmill.", 10) == 0 || strncmp(a->name, "cryptomatte/", 12) == 0;
        if (!ours || strcmp(a->name, "lightmill.mix") == 0) continue;
        if (!plain && strcmp(a->name, "lightmill.error") == 0) continue;
        if (a->kind == ATTRIBUTE_STRING) image_set_string(mixed, a->name, a->text);
        if (a->kind == ATTRIBUTE_INT) image_set_int(mixed, a->name, a->integer);
        if (a->kind == ATTRIBUTE_FLOAT) image_set_float(mixed, a->name, a->real);
    }
}

/* "key=2,2,2 sky=1,1,1": what it takes to do the same again. */
static void note_factors(const mixture_t *mixture, image_t *mixed)
{
    char text[MIXTURE_MAX_GROUPS * 128];
    size_t used = 0;
    for (size_t g = 0; g < mixture->count; g++) {
        const double *f = mixture->groups[g].factor;
        used += (size_t)snprintf(text + used, sizeof text - used, "%s%s=%.6g,%.6g,%.6g", g > 0 ? " " : "",
                                 mixture->groups[g].name, f[0], f[1], f[2]);
    }
    image_set_string(mixed, "lightmill.mix", text);
}

result_t mixture_make(const mixture_t *mixture, bool half, image_t *mixed)
{
    const image_t *image = mixture->image;
    bool plain = is_plain(mixture);
    image_init(mixed, image->width, image->height);
    if (!plain) TRY(mix_channels(mixture, half ? PIXEL_HALF : PIXEL_FLOAT, mixed));
    for (size_t i = 0; i < image->channel_count; i++) {
        const image_channel_t *channel = &image->channels[i];
        bool kept = !is_lit(channel->name) || (plain && is_picture(channel->name));
        pixel_type_t type = half && picture_half_fits(channel->name) ? PIXEL_HALF : PIXEL_FLOAT;
        if (kept) image_add_view(mixed, channel->name, type, channel->data, channel->stride);
    }
    copy_attributes(image, plain, mixed);
    note_factors(mixture, mixed);
    return result_ok();
}
