/* values: the parameters that may come from a texture: floats and colours. */
#ifndef LIGHTMILL_PBRT_VALUES_H
#define LIGHTMILL_PBRT_VALUES_H

#include "client/import/pbrt/state/state.h"

/* A number that may come from a float texture: *value keeps its default when the parameter is not there. A
 * constant must be at least 0. */
result_t pbrt_float_value(pbrt_t *p, params_t *params, const char *name, blob_value_t *value);
/* The same for what may be negative: a displacement. */
result_t pbrt_signed_value(pbrt_t *p, params_t *params, const char *name, blob_value_t *value);

typedef enum {
    COLOUR_REFLECTANCE, /* v4 takes it for at most 1, v3 keeps it */
    COLOUR_UNBOUNDED,   /* a part of a texture: a reflectance that is not limited */
    COLOUR_INDEX,       /* of a metal: eta and k */
    COLOUR_LIGHT        /* emitted */
} colour_use_t;

/* A colour, in linear sRGB, that may come from a spectrum texture; no component of a constant is negative. A
 * constant that the file has as a spectrum has that, too, for spectral jobs. */
result_t pbrt_colour_value(pbrt_t *p, params_t *params, const char *name, colour_use_t use,
                           blob_value_t *value);
/* The same of what cannot vary: a texture is an error, unless it is constant. */
result_t pbrt_constant_colour(pbrt_t *p, params_t *params, const char *name, colour_use_t use,
                              blob_value_t *value);
/* Its linear sRGB alone. */
result_t pbrt_colour(pbrt_t *p, params_t *params, const char *name, colour_use_t use, rgb_t *value);

/* A dielectric's index of refraction from a parameter of type spectrum, its value at the d line, 587.56 nm;
 * or in v4 of type rgb, its luminance. */
result_t pbrt_index(pbrt_t *p, params_t *params, const char *name, blob_value_t *value);

/* The index of a metal that is known by name; black when it is not. */
blob_value_t pbrt_named_index(pbrt_t *p, const char *name);

#endif
