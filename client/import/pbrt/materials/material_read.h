/* material_read: how parameters that several materials have become values of the blob's record. */
#ifndef LIGHTMILL_MATERIAL_READ_H
#define LIGHTMILL_MATERIAL_READ_H

#include "client/import/pbrt/state/values.h"

/* VALUE_ETA: an index of refraction that is one number. */
result_t material_read_index(pbrt_t *p, params_t *params, const char *name, float otherwise, position_t at,
                             blob_material_t *record);
/* How a material says its roughness. */
typedef struct {
    const char *names[3]; /* of the parameters for both axes, along u, along v; NULL: there is no such */
    bool v_as_u;          /* without its own, the axis v has that along u; else that of both */
    float otherwise;      /* without any */
    bool smooth;          /* all 0 makes a smooth surface */
} roughness_rule_t;

/* The roughness of two axes, in two slots from `slot` on, and what makes alphas of it. */
result_t material_read_roughness(pbrt_t *p, params_t *params, const roughness_rule_t *rule,
                                 material_value_t slot, position_t at, blob_material_t *record);
/* VALUE_K and, in `eta_slot`, eta of a metal, copper's by default; in v4 by its reflectance, too. */
result_t material_read_metal(pbrt_t *p, params_t *params, const char *eta, const char *k,
                             material_value_t eta_slot, blob_material_t *record);

#endif
