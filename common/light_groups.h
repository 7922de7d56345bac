/* light_groups: the groups that the lights of a scene are sorted into, so that the picture of each group can
 * be told apart and mixed anew (`--light-groups`).
 *
 * A user writes NAME=SELECTOR+SELECTOR,...: a selector is a kind of light ("area"), the number of a light in
 * the scene ("3"), some in a row ("3-7"), or the place in the scene file that it comes from ("room.pbrt:27").
 * A number or a place takes a light out of the group that has its kind. Lights in no group make the group
 * "rest". "kinds" stands for a group a kind, "each" for a group a light.
 *
 * light_groups_resolve makes of this the text that a job's settings hold: the same with numbers for places,
 * with nothing that stands for something else, and with ",rest" at the end if there is a rest. So it names
 * every group, in their order, and the number of groups can be told without the scene. Whoever has the scene
 * sorts its lights by light_groups_assign.
 */
#ifndef LIGHTMILL_LIGHT_GROUPS_H
#define LIGHTMILL_LIGHT_GROUPS_H

#include "common/base.h"

enum {
    LIGHT_GROUPS_MAX = 8,
    LIGHT_GROUPS_TEXT = 511, /* bytes of the text */
    LIGHT_GROUP_NAME = 16,   /* bytes of a name, so that "group.NAME.light.R" fits an EXR of old */
    LIGHT_KINDS_COUNT = 7    /* of lights, numbered from 1 as light_kind_t (common/scene/blob_format.h) */
};

/* What the kinds are called; [0] is NULL. */
extern const char *const light_kind_names[LIGHT_KINDS_COUNT + 1];

/* A light of a scene. */
typedef struct {
    uint32_t kind;     /* light_kind_t */
    const char *place; /* "file:line"; NULL or empty: not known */
} grouped_light_t;

/* Makes the text of the settings of what a user wrote, for these lights, which stand in the order of their
 * numbers. Empty text gives none. RESULT_USAGE says what is wrong, and what lights or groups there are. */
result_t light_groups_resolve(const char *text, const grouped_light_t *lights, size_t count,
                              char resolved[LIGHT_GROUPS_TEXT + 1]);
/* RESULT_USAGE when it is not such text; the scene is not asked. */
result_t light_groups_check(const char *resolved);
/* How many groups there are; 0 for empty text. The text is checked, here and below. */
uint32_t light_groups_count(const char *resolved);
/* What one of them is called. */
void light_groups_name(const char *resolved, uint32_t group, char name[LIGHT_GROUP_NAME + 1]);
/* Writes the group of each light. RESULT_USAGE when the text is not of this scene: a light is missing, in no
 * group or in two. */
result_t light_groups_assign(const char *resolved, const grouped_light_t *lights, size_t count,
                             uint8_t *groups);

#endif
