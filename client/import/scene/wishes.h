/* wishes: what whoever imports a scene asks for beyond what its file says.
 *
 * A reader finds them in its report (report.h); those that concern every format are granted behind the reader
 * (client/import/import.c). The texts are kept by the caller.
 */
#ifndef LIGHTMILL_WISHES_H
#define LIGHTMILL_WISHES_H

#include <ctype.h>
#include <math.h>
#include <stdlib.h>

#include "common/options/options.h"

typedef struct {
    bool lenient, strict;       /* see import_report_t */
    const char *environment;    /* light from all around: see environment.h; NULL: the scene's own */
    double environment_turn;    /* degrees about the axis that points up, counter-clockwise seen from above */
    double environment_factor;  /* on its radiance */
    const char *environment_up; /* "y" or "z": the axis of the world that points up; NULL: y */
    const char *camera; /* the name of one of several cameras, or its number from 1; NULL: the usual one */
    const char
        *variant;       /* the name of one of several looks, or its number from 1; NULL: as the file stands */
    double fov;         /* degrees along the shorter side of the picture; 0: the camera's */
    double lens_radius; /* in units of the scene; below 0: the camera's */
    const char *focus;  /* a distance along the view, or the name of an object; NULL: the camera's */
    option_list_t definitions; /* NAME=VALUE: of a Mitsuba scene's parameters */
    double time_point;         /* of animations, seconds; NaN: none, or `frame` */
    double frame;              /* instead of it; NaN: none */
    double frames_per_second;  /* what makes a time of a frame */
    const char *animation; /* the name of one of several animations, or its number from 1; NULL: all that go
                              together */
    const char *shutter;   /* how long it is open then: "SECONDS" or "OPEN,CLOSE"; NULL: nothing moves */
} import_wishes_t;

/* Nothing is asked for. */
static inline import_wishes_t import_wishes_none(void)
{
    return (import_wishes_t){.environment_factor = 1,
                             .lens_radius = -1,
                             .time_point = (double)NAN,
                             .frame = (double)NAN,
                             .frames_per_second = 24};
}

/* True when they ask for a moment of the scene's animations. */
static inline bool wishes_have_moment(const import_wishes_t *wishes)
{
    return !isnan(wishes->time_point) || !isnan(wishes->frame);
}

/* That moment in seconds. */
static inline double wishes_moment(const import_wishes_t *wishes)
{
    return isnan(wishes->frame) ? wishes->time_point : wishes->frame / wishes->frames_per_second;
}

/* The index of what a text asks for that is a number from 1 to `count`; false when it is none. */
static inline bool wishes_number(const char *text, size_t count, size_t *index)
{
    char *end;
    unsigned long number = strtoul(text, &end, 10);
    if (!isdigit((unsigned char)text[0]) || *end != '\0' || number < 1 || number > count) return false;
    *index = number - 1;
    return true;
}

#endif
