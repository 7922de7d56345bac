/* property: what the elements of a Mitsuba scene hold: numbers, colours, transforms, and other objects, also
 * by reference.
 *
 * Every function marks what it reads as used. object_finish tells what nobody asked for.
 */
#ifndef LIGHTMILL_PROPERTY_H
#define LIGHTMILL_PROPERTY_H

#include "client/import/mitsuba/xml.h"

/* What a bsdf becomes. */
typedef struct {
    uint32_t index;     /* in the blob; BLOB_NONE: the surface is invisible (null) */
    blob_value_t alpha; /* of the shapes that have it */
} material_t;

/* A scene on its way. Owned: all but `scene` and `report`. */
typedef struct {
    scene_builder_t *scene;
    report_t *report;
    xml_t xml;
    intern_t ids;
    element_t **by_id;
    size_t id_capacity;
    material_t *materials; /* element_t.object and .variant are 1 + an index into them */
    size_t material_count, material_capacity;
    rgb_t *image_most; /* of the blob's images: see texture_most */
    size_t image_most_capacity;
    uint32_t plain, black; /* 1 + the material of shapes that have none, and emit; 0: not made yet */
    blob_scene_t record;
    double shutter[2]; /* when it opens and closes */
    int material_depth;
    bool said_one_sided, said_beckmann, said_library;
} mitsuba_t;

/* Gathers the ids of all elements. RESULT_INPUT: one is given twice. */
result_t property_collect_ids(mitsuba_t *m);

/* The type of an object: its attribute, or "". */
const char *object_type(const element_t *object);
/* The first child object of that tag and name, which may be a reference, or NULL. RESULT_INPUT: a reference
 * to what is not there. */
result_t object_named(mitsuba_t *m, const element_t *object, const char *tag, const char *name,
                      element_t **found);
/* The child objects of that tag, one by one: begin with `after` NULL; references are followed. *found is NULL
 * at the end, else *name is the name that it has there, or "". RESULT_INPUT: a reference to what is not
 * there.
 */
result_t object_child(mitsuba_t *m, const element_t *object, const char *tag, element_t **at,
                      element_t **found, const char **name);
/* A child that only one of is expected: the first; NULL: none. */
result_t object_only(mitsuba_t *m, const element_t *object, const char *tag, element_t **found);
/* Tells of each child that nobody has asked for. Of an object it is an error, or, when the import is lenient,
 * a warning; Mitsuba ignores properties that it does not know: see report_tolerate. Also of those that are
 * given twice. */
result_t object_finish(mitsuba_t *m, const element_t *object);
/* Marks children of that name as used. */
void property_ignore(const element_t *object, const char *name);

/* The child of that name, of any tag, the last of several, as in Mitsuba; NULL: none. */
element_t *property_find(const element_t *object, const char *name);
/* Each leaves *value as it is where there is no property of that name. A number beyond its bounds is an
 * error.
 */
result_t property_number(mitsuba_t *m, const element_t *object, const char *name, double low, double high,
                         double *value);
result_t property_bool(mitsuba_t *m, const element_t *object, const char *name, bool *value);
result_t property_string(mitsuba_t *m, const element_t *object, const char *name, const char **value);
result_t property_point(mitsuba_t *m, const element_t *object, const char *name, double value[3]);
result_t property_colour(mitsuba_t *m, const element_t *object, const char *name, rgb_t *value);
/* The colour that an element rgb, srgb, spectrum, blackbody or float is; false: it is none of these. */
bool element_is_colour(const element_t *element);
result_t element_colour(mitsuba_t *m, const element_t *element, rgb_t *value);
/* A transform, or an animation at the times when the shutter opens and closes: mitsuba_t.shutter. */
result_t property_motion(mitsuba_t *m, const element_t *object, const char *name, affine_t motion[2]);
bool motion_is_still(const affine_t motion[2]);
/* The same of what cannot move: as when the shutter opens. RESULT_INPUT when it would move after that, unless
 * the import is lenient. */
result_t property_transform(mitsuba_t *m, const element_t *object, const char *name, affine_t *value);
/* The frame at `origin` whose z axis points to `target`; false when they are one. `up` NULL: y lies as near
 * as it can to the axis that is most across. */
bool frame_towards(const double origin[3], const double target[3], const double *up, affine_t *frame);

#endif
