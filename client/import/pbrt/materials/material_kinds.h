/* material_kinds: how a Material's parameters become the blob's record: the readers that the materials of
 * both dialects share (material_read.c), and the materials themselves (materials_v3.c, materials_v4.c). */
#ifndef LIGHTMILL_MATERIAL_KINDS_H
#define LIGHTMILL_MATERIAL_KINDS_H

#include "client/import/pbrt/state/values.h"

typedef enum { NUMBER, REFLECTANCE } value_type_t;

/* A parameter that becomes a value of the record: its default is `otherwise` in all components. */
typedef struct {
    const char *name;
    material_value_t slot;
    value_type_t type;
    float otherwise;
} value_rule_t;

/* Reads the values that the rules name. */
result_t material_read_values(pbrt_t *p, params_t *params, const value_rule_t *rules, size_t count,
                              blob_material_t *record);
#define READ_VALUES(rules) TRY(material_read_values(p, params, rules, ARRAY_LENGTH(rules), record))

/* An index of refraction that is one number. */
result_t material_read_index(pbrt_t *p, params_t *params, const char *name, material_value_t slot,
                             float otherwise, position_t at, blob_material_t *record);

/* The names of a roughness's parameters: for both axes, along u, along v; NULL: there is no such. */
extern const char *const material_both_axes[3], *const material_each_axis[3], *const material_all_axes[3];
/* Reads the roughness and what becomes of it: `smooth` tells that 0 makes a smooth surface. */
result_t material_read_roughness(pbrt_t *p, params_t *params, const char *const names[3], float otherwise,
                                 bool smooth, position_t at, blob_material_t *record);
/* The two halves of it: the values, for two axes from `slot` on, and how `count` of them become alphas. */
result_t material_read_axes(pbrt_t *p, params_t *params, const char *const names[3], float otherwise,
                            material_value_t slot, blob_material_t *record);
result_t material_finish_roughness(pbrt_t *p, params_t *params, position_t at, material_value_t slot,
                                   int count, bool smooth, blob_material_t *record);

/* eta and k of a metal, copper's by default. */
result_t material_read_metal(pbrt_t *p, params_t *params, const char *eta, const char *k,
                             material_value_t eta_slot, blob_material_t *record);
/* The same, or a reflectance instead. */
result_t material_read_metal_v4(pbrt_t *p, params_t *params, const char *eta, const char *k,
                                material_value_t eta_slot, bool can_tint, blob_material_t *record);

/* Fills the record (zero but for the name) from the parameters; a kind that stays 0 is an interface. */
typedef result_t material_make_t(pbrt_t *p, params_t *params, const material_t *material,
                                 blob_material_t *record);

/* pbrt-v3 */
extern material_make_t material_make_matte, material_make_mirror, material_make_glass, material_make_metal,
    material_make_plastic, material_make_substrate, material_make_translucent, material_make_uber,
    material_make_disney;
/* pbrt-v4 */
extern material_make_t material_make_diffuse, material_make_conductor, material_make_dielectric,
    material_make_thin_dielectric, material_make_coated_diffuse, material_make_coated_conductor,
    material_make_diffuse_transmission;

#endif
