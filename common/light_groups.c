/* light_groups: see light_groups.h. */
#include "common/light_groups.h"

#include <ctype.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

const char *const light_kind_names[LIGHT_KINDS_COUNT + 1] = {
    NULL, "area", "point", "spot", "goniometric", "projection", "distant", "infinite"};

#define REST "rest"
static const char EXAMPLE[] = "key=3+4,sky=infinite";

/* ---- text ---------------------------------------------------------------------------------------------- */

/* A part of a text. */
typedef struct {
    const char *text;
    size_t size;
} part_t;

/* The part of *rest up to the next `stop`, which *rest then lies behind; at the end *rest becomes NULL. */
static part_t next_part(const char **rest, const char *end, char stop)
{
    part_t part = {*rest, (size_t)(end - *rest)};
    const char *found = memchr(*rest, stop, part.size);
    if (found != NULL) part.size = (size_t)(found - *rest);
    *rest = found != NULL ? found + 1 : NULL;
    return part;
}

static bool part_is(part_t part, const char *text)
{
    return strlen(text) == part.size && memcmp(part.text, text, part.size) == 0;
}

/* The texts of a group. */
typedef struct {
    part_t name;
    part_t selectors; /* empty: of the rest */
} group_t;

static group_t split_group(part_t part)
{
    const char *equals = memchr(part.text, '=', part.size);
    if (equals == NULL) return (group_t){.name = part};
    size_t name = (size_t)(equals - part.text);
    return (group_t){.name = {part.text, name}, .selectors = {equals + 1, part.size - name - 1}};
}

/* All of them; how many there are may be more than fit. */
static size_t split_groups(const char *text, group_t groups[LIGHT_GROUPS_MAX + 1])
{
    size_t count = 0;
    const char *end = text + strlen(text);
    for (const char *rest = *text != '\0' ? text : NULL; rest != NULL;) {
        group_t group = split_group(next_part(&rest, end, ','));
        if (count <= LIGHT_GROUPS_MAX) groups[count] = group;
        count++;
    }
    return count;
}

static result_t check_name(part_t name)
{
    bool good = name.size >= 1 && name.size <= LIGHT_GROUP_NAME;
    for (size_t i = 0; i < name.size && good; i++)
        good = isalnum((unsigned char)name.text[i]) || name.text[i] == '_' || name.text[i] == '-';
    if (good) return result_ok();
    return result_fail(RESULT_USAGE,
                       "'%.*s' names no light group: a name has up to %d letters, digits, '_' and '-'",
                       (int)(name.size < 60 ? name.size : 60), name.text, LIGHT_GROUP_NAME);
}

/* Names are good and differ, and only the rest has no selectors, and comes last. */
static result_t check_groups(const group_t *groups, size_t count)
{
    if (count > LIGHT_GROUPS_MAX)
        return result_fail(RESULT_USAGE,
                           "there are %zu light groups, and at most %d can be: put lights "
                           "together, as in %s; those in no group make the group '" REST "'",
                           count, LIGHT_GROUPS_MAX, EXAMPLE);
    for (size_t i = 0; i < count; i++) {
        const group_t *group = &groups[i];
        TRY(check_name(group->name));
        bool rest = part_is(group->name, REST);
        if (rest != (group->selectors.text == NULL) || (rest && i + 1 < count))
            return result_fail(RESULT_USAGE,
                               "light group '%.*s': write NAME=LIGHTS, as in %s; lights in no group make "
                               "the group '" REST "'",
                               (int)group->name.size, group->name.text, EXAMPLE);
        for (size_t k = 0; k < i; k++)
            if (group->name.size == groups[k].name.size &&
                memcmp(group->name.text, groups[k].name.text, group->name.size) == 0)
                return result_fail(RESULT_USAGE, "there are two light groups '%.*s'", (int)group->name.size,
                                   group->name.text);
    }
    return result_ok();
}

/* ---- selectors ----------------------------------------------------------------------------------------- */

typedef struct {
    uint32_t kind;      /* 0: by number */
    size_t first, last; /* numbers */
} selector_t;

/* A number of up to nine digits at *text, which it moves behind. */
static bool read_number(const char **text, const char *end, size_t *number)
{
    const char *start = *text;
    for (*number = 0; *text < end && isdigit((unsigned char)**text) && *text - start < 9; ++*text)
        *number = 10 * *number + (size_t)(**text - '0');
    return *text > start;
}

/* False when it is neither a kind nor numbers. */
static bool read_selector(part_t part, selector_t *selector)
{
    *selector = (selector_t){0};
    for (uint32_t k = 1; k <= LIGHT_KINDS_COUNT; k++)
        if (part_is(part, light_kind_names[k])) selector->kind = k;
    if (selector->kind != 0) return true;
    const char *at = part.text, *end = part.text + part.size;
    if (!read_number(&at, end, &selector->first)) return false;
    selector->last = selector->first;
    if (at == end) return true;
    return *at++ == '-' && read_number(&at, end, &selector->last) && at == end &&
           selector->last >= selector->first;
}

static result_t no_selector(const group_t *group, part_t part)
{
    return result_fail(RESULT_USAGE,
                       "light group '%.*s': '%.*s' selects no lights: give a kind (area, point, spot, "
                       "goniometric, projection, distant, infinite) or numbers (3, 3-7) as lightmill info "
                       "SCENE lists them",
                       (int)group->name.size, group->name.text, (int)(part.size < 100 ? part.size : 100),
                       part.text);
}

result_t light_groups_check(const char *resolved)
{
    group_t groups[LIGHT_GROUPS_MAX + 1];
    selector_t selector;
    if (strlen(resolved) > LIGHT_GROUPS_TEXT)
        return result_fail(RESULT_USAGE, "light groups take %zu bytes, the limit is %d", strlen(resolved),
                           LIGHT_GROUPS_TEXT);
    size_t count = split_groups(resolved, groups);
    TRY(check_groups(groups, count));
    for (size_t i = 0; i < count; i++) {
        const part_t *all = &groups[i].selectors;
        for (const char *rest = all->text; rest != NULL;) {
            part_t part = next_part(&rest, all->text + all->size, '+');
            if (!read_selector(part, &selector)) return no_selector(&groups[i], part);
        }
    }
    return result_ok();
}

uint32_t light_groups_count(const char *resolved)
{
    uint32_t count = resolved[0] != '\0';
    for (const char *comma = resolved; (comma = strchr(comma, ',')) != NULL; comma++) count++;
    return count;
}

void light_groups_name(const char *resolved, uint32_t group, char name[LIGHT_GROUP_NAME + 1])
{
    group_t groups[LIGHT_GROUPS_MAX + 1];
    bool there = group < LIGHT_GROUPS_MAX && group < split_groups(resolved, groups);
    snprintf(name, LIGHT_GROUP_NAME + 1, "%.*s", there ? (int)groups[group].name.size : 0,
             there ? groups[group].name.text : "");
}

/* ---- sorting lights ------------------------------------------------------------------------------------ */

enum { NO_GROUP = LIGHT_GROUPS_MAX };

/* How strong the claim of a group on a light is. */
enum { CLAIM_NONE, CLAIM_KIND, CLAIM_NUMBER };

typedef struct {
    const grouped_light_t *lights;
    size_t count;
    group_t groups[LIGHT_GROUPS_MAX + 1];
    uint8_t *group_of; /* [count] */
    uint8_t *claims;   /* [count] */
} sorting_t;

/* What the scene has, for messages: "area (0-2), point (3)". */
static void list_lights(const sorting_t *sorting, char *text, size_t size)
{
    size_t used = 0;
    text[0] = '\0';
    for (size_t first = 0, last; first < sorting->count && used < size; first = last + 1) {
        uint32_t kind = sorting->lights[first].kind;
        for (last = first; last + 1 < sorting->count && sorting->lights[last + 1].kind == kind;) last++;
        const char *name = kind >= 1 && kind <= LIGHT_KINDS_COUNT ? light_kind_names[kind] : "unknown";
        int more = first == last
                       ? snprintf(text + used, size - used, "%s%s (%zu)", first > 0 ? ", " : "", name, first)
                       : snprintf(text + used, size - used, "%s%s (%zu-%zu)", first > 0 ? ", " : "", name,
                                  first, last);
        used += (size_t)more;
    }
}

static result_t no_light(const sorting_t *sorting, size_t group, part_t part)
{
    char list[200];
    list_lights(sorting, list, sizeof list);
    return result_fail(RESULT_USAGE, "light group '%.*s': the scene has no light '%.*s'; it has %s",
                       (int)sorting->groups[group].name.size, sorting->groups[group].name.text,
                       (int)(part.size < 100 ? part.size : 100), part.text, list[0] != '\0' ? list : "none");
}

static result_t claim(sorting_t *sorting, size_t light, size_t group, uint8_t strength)
{
    if (sorting->claims[light] > strength) return result_ok();
    size_t other = sorting->group_of[light];
    if (sorting->claims[light] == strength && other != group)
        return result_fail(RESULT_USAGE, "light %zu is in the groups '%.*s' and '%.*s'", light,
                           (int)sorting->groups[other].name.size, sorting->groups[other].name.text,
                           (int)sorting->groups[group].name.size, sorting->groups[group].name.text);
    sorting->claims[light] = strength;
    sorting->group_of[light] = (uint8_t)group;
    return result_ok();
}

static result_t claim_selected(sorting_t *sorting, size_t group, part_t part)
{
    selector_t selector;
    bool any = false;
    if (!read_selector(part, &selector)) return no_selector(&sorting->groups[group], part);
    if (selector.kind == 0) {
        if (selector.last >= sorting->count) return no_light(sorting, group, part);
        for (size_t i = selector.first; i <= selector.last; i++) TRY(claim(sorting, i, group, CLAIM_NUMBER));
        return result_ok();
    }
    for (size_t i = 0; i < sorting->count; i++) {
        if (sorting->lights[i].kind != selector.kind) continue;
        any = true;
        TRY(claim(sorting, i, group, CLAIM_KIND));
    }
    return any ? result_ok() : no_light(sorting, group, part);
}

/* Sorts all lights; those that nobody selects are left with NO_GROUP. */
static result_t claim_all(sorting_t *sorting, size_t group_count)
{
    memset(sorting->group_of, NO_GROUP, sorting->count);
    memset(sorting->claims, CLAIM_NONE, sorting->count);
    for (size_t g = 0; g < group_count; g++) {
        const part_t *all = &sorting->groups[g].selectors;
        for (const char *rest = all->text; rest != NULL;)
            TRY(claim_selected(sorting, g, next_part(&rest, all->text + all->size, '+')));
    }
    return result_ok();
}

/* Every light has a group, and every group a light. `rest`: the last of them takes what is left. */
static result_t check_claims(sorting_t *sorting, size_t group_count, bool rest)
{
    size_t members[LIGHT_GROUPS_MAX] = {0};
    for (size_t i = 0; i < sorting->count; i++) {
        if (sorting->group_of[i] == NO_GROUP) {
            if (!rest) return result_fail(RESULT_USAGE, "light %zu is in no light group", i);
            sorting->group_of[i] = (uint8_t)(group_count - 1);
        }
        members[sorting->group_of[i]]++;
    }
    for (size_t g = 0; g < group_count; g++)
        if (members[g] == 0)
            return result_fail(RESULT_USAGE, "no light of the scene is left for the light group '%.*s'",
                               (int)sorting->groups[g].name.size, sorting->groups[g].name.text);
    return result_ok();
}

result_t light_groups_assign(const char *resolved, const grouped_light_t *lights, size_t count,
                             uint8_t *groups)
{
    TRY(light_groups_check(resolved));
    sorting_t sorting = {
        .lights = lights, .count = count, .group_of = groups, .claims = mem_zalloc(count + 1, 1)};
    size_t group_count = split_groups(resolved, sorting.groups);
    result_t result = claim_all(&sorting, group_count);
    bool rest = group_count > 0 && part_is(sorting.groups[group_count - 1].name, REST);
    if (result.code == RESULT_OK) result = check_claims(&sorting, group_count, rest);
    free(sorting.claims);
    return result;
}

/* ---- what a user wrote --------------------------------------------------------------------------------- */

/* Text that grows up to a limit; beyond it `full`. */
typedef struct {
    char *text;
    size_t size, limit;
    bool full;
} writer_t;

static void __attribute__((format(printf, 2, 3))) put(writer_t *writer, const char *format, ...)
{
    va_list list;
    va_start(list, format);
    int more = vsnprintf(writer->text + writer->size, writer->limit + 1 - writer->size, format, list);
    va_end(list);
    writer->full = writer->full || writer->size + (size_t)more > writer->limit;
    if (!writer->full) writer->size += (size_t)more;
}

/* True when the place of a light is this one, or ends with it behind a '/'. */
static bool is_place(const grouped_light_t *light, part_t part)
{
    size_t size = light->place != NULL ? strlen(light->place) : 0;
    if (part.size == 0 || size < part.size) return false;
    const char *end = light->place + size - part.size;
    return memcmp(end, part.text, part.size) == 0 && (end == light->place || end[-1] == '/');
}

/* A selector as it was, or the numbers of the lights of a place. */
static result_t put_selector(writer_t *writer, const sorting_t *sorting, size_t group, part_t part)
{
    selector_t selector;
    bool any = false;
    if (read_selector(part, &selector)) {
        put(writer, "%.*s", (int)part.size, part.text);
        return result_ok();
    }
    for (size_t first = 0, last; first < sorting->count; first = last + 1) {
        last = first;
        if (!is_place(&sorting->lights[first], part)) continue;
        while (last + 1 < sorting->count && is_place(&sorting->lights[last + 1], part)) last++;
        put(writer, first == last ? "%s%zu" : "%s%zu-%zu", any ? "+" : "", first, last);
        any = true;
    }
    if (any) return result_ok();
    bool like_place = memchr(part.text, ':', part.size) != NULL;
    return like_place ? no_light(sorting, group, part) : no_selector(&sorting->groups[group], part);
}

static result_t put_groups(writer_t *writer, const sorting_t *sorting, size_t group_count)
{
    for (size_t g = 0; g < group_count; g++) {
        const group_t *group = &sorting->groups[g];
        if (group->selectors.text == NULL) break; /* the rest, which is put if there is one */
        put(writer, "%s%.*s=", g > 0 ? "," : "", (int)group->name.size, group->name.text);
        for (const char *rest = group->selectors.text; rest != NULL;) {
            TRY(put_selector(writer, sorting, g,
                             next_part(&rest, group->selectors.text + group->selectors.size, '+')));
            if (rest != NULL) put(writer, "+");
        }
    }
    return result_ok();
}

/* Groups for one of the words that stand for them; false when the text is none of these. */
static bool put_shorthand(writer_t *writer, const char *text, const grouped_light_t *lights, size_t count)
{
    bool seen[LIGHT_KINDS_COUNT + 1] = {false};
    bool kinds = strcmp(text, "kinds") == 0;
    if (!kinds && strcmp(text, "each") != 0) return false;
    for (size_t i = 0; i < count; i++) {
        uint32_t kind = lights[i].kind;
        if (!kinds)
            put(writer, "%slight%zu=%zu", i > 0 ? "," : "", i, i);
        else if (kind <= LIGHT_KINDS_COUNT && kind > 0 && !seen[kind])
            put(writer, "%s%s=%s", i > 0 ? "," : "", light_kind_names[kind], light_kind_names[kind]);
        if (kind <= LIGHT_KINDS_COUNT) seen[kind] = true;
    }
    return true;
}

/* Appends the rest if there is one; then all must be well. */
static result_t put_rest(writer_t *writer, sorting_t *sorting)
{
    TRY(light_groups_check(writer->text));
    TRY(claim_all(sorting, split_groups(writer->text, sorting->groups)));
    bool left = sorting->count > 0 && memchr(sorting->group_of, NO_GROUP, sorting->count) != NULL;
    if (left) put(writer, writer->size > 0 ? "," REST : REST);
    return result_ok();
}

static result_t resolve(const char *text, sorting_t *sorting, writer_t *writer)
{
    if (strcmp(text, "each") == 0 && sorting->count > LIGHT_GROUPS_MAX)
        return result_fail(RESULT_USAGE,
                           "the scene has %zu lights, and there can be at most %d light groups: "
                           "name some, as in %s; the others make the group '" REST "'",
                           sorting->count, LIGHT_GROUPS_MAX, EXAMPLE);
    if (!put_shorthand(writer, text, sorting->lights, sorting->count)) {
        size_t count = split_groups(text, sorting->groups);
        TRY(check_groups(sorting->groups, count));
        TRY(put_groups(writer, sorting, count));
    }
    if (!writer->full) TRY(put_rest(writer, sorting));
    if (writer->full)
        return result_fail(RESULT_USAGE,
                           "light groups take more than %d bytes; ranges are shorter, as in 3-7",
                           LIGHT_GROUPS_TEXT);
    return light_groups_assign(writer->text, sorting->lights, sorting->count, sorting->group_of);
}

result_t light_groups_resolve(const char *text, const grouped_light_t *lights, size_t count,
                              char resolved[LIGHT_GROUPS_TEXT + 1])
{
    resolved[0] = '\0';
    if (text[0] == '\0') return result_ok();
    if (count == 0) return result_fail(RESULT_USAGE, "the scene has no lights to make groups of");
    sorting_t sorting = {
        .lights = lights, .count = count, .group_of = mem_alloc(count), .claims = mem_alloc(count)};
    writer_t writer = {.text = resolved, .limit = LIGHT_GROUPS_TEXT};
    result_t result = resolve(text, &sorting, &writer);
    if (result.code != RESULT_OK) resolved[0] = '\0';
    free(sorting.group_of);
    free(sorting.claims);
    return result;
}
