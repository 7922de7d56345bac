/* directives: the functions behind the table of directives in pbrt.c, and the helpers they share.
 *
 * A directive's function is called with the place of its name when the name has been read; it reads the rest.
 */
#ifndef LIGHTMILL_DIRECTIVES_H
#define LIGHTMILL_DIRECTIVES_H

#include "client/import/pbrt/state.h"

/* transforms.c */
result_t pbrt_identity(pbrt_t *p, position_t at);
result_t pbrt_translate(pbrt_t *p, position_t at);
result_t pbrt_scale(pbrt_t *p, position_t at);
result_t pbrt_rotate(pbrt_t *p, position_t at);
result_t pbrt_look_at(pbrt_t *p, position_t at);
result_t pbrt_transform(pbrt_t *p, position_t at);
result_t pbrt_concat_transform(pbrt_t *p, position_t at);
result_t pbrt_coordinate_system(pbrt_t *p, position_t at);
result_t pbrt_coord_sys_transform(pbrt_t *p, position_t at);
result_t pbrt_active_transform(pbrt_t *p, position_t at);
result_t pbrt_transform_times(pbrt_t *p, position_t at);

/* options.c */
result_t pbrt_camera(pbrt_t *p, position_t at);
result_t pbrt_film(pbrt_t *p, position_t at);
result_t pbrt_sampler(pbrt_t *p, position_t at);
result_t pbrt_integrator(pbrt_t *p, position_t at);
result_t pbrt_pixel_filter(pbrt_t *p, position_t at);
result_t pbrt_accelerator(pbrt_t *p, position_t at);
result_t pbrt_option(pbrt_t *p, position_t at);
/* What depends on several options, at WorldBegin. */
result_t pbrt_options_finish(pbrt_t *p);

/* materials.c */
result_t pbrt_material(pbrt_t *p, position_t at);
result_t pbrt_make_named_material(pbrt_t *p, position_t at);
result_t pbrt_named_material(pbrt_t *p, position_t at);
/* Makes material 0, which shapes have when none is set. */
void pbrt_default_material(pbrt_t *p);
/* The index in the blob of the current material as a shape with these parameters wears it: in v3 they
 * override the material's own. BLOB_NONE: an interface between media, which does nothing to light; the shape
 * is left out of the scene without a word. */
result_t pbrt_wear_material(pbrt_t *p, params_t *shape_params, uint32_t *index);
/* v4: makes the materials that shapes wear whose names, or the names of their textures, came later. */
result_t pbrt_finish_materials(pbrt_t *p);
/* Checks the materials that no shape wears: warnings only. */
void pbrt_check_unused_materials(pbrt_t *p);

/* textures.c */
result_t pbrt_texture(pbrt_t *p, position_t at);
/* Refuses what a blob must not have in the textures that came since the last call: numbers that are not
 * finite, and more than BLOB_MAX_TEXTURE_COST textures in one. */
result_t pbrt_check_textures(pbrt_t *p, position_t at);
/* The texture of a normal map over the surface's (u, v). */
result_t pbrt_normal_map(pbrt_t *p, const char *filename, position_t at, blob_ref_t *texture);

/* values.c */
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

/* A colour, in linear sRGB, that may come from a spectrum texture; no component of a constant is negative. */
result_t pbrt_colour_value(pbrt_t *p, params_t *params, const char *name, colour_use_t use,
                           blob_value_t *value);
/* The same of what cannot vary: a texture is an error, unless it is constant. */
result_t pbrt_colour(pbrt_t *p, params_t *params, const char *name, colour_use_t use, rgb_t *value);

/* A dielectric's index of refraction from a parameter of type spectrum: its value at the d line, 587.56 nm.
 */
result_t pbrt_index(pbrt_t *p, params_t *params, const char *name, blob_value_t *value);

/* The index of a metal that is known by name; black when it is not. */
blob_value_t pbrt_named_index(const pbrt_t *p, const char *name);

/* images.c */
/* How the numbers of a file are encoded: as its format says, or a gamma of blob_image_t (0: sRGB, 1: linear).
 */
#define IMAGE_GAMMA_OF_FILE (-1.0f)
/* Reads an image file into the blob, once for each encoding. `filename` is as in the scene (see
 * pbrt_resolve). Fails at `at` when it cannot be read. */
result_t pbrt_image(pbrt_t *p, const char *filename, float gamma, position_t at, blob_ref_t *image);
/* What the texture of an image must know about it. */
const image_file_t *pbrt_image_file(const pbrt_t *p, blob_ref_t image);

/* colour_spaces.c */
result_t pbrt_color_space(pbrt_t *p, position_t at);
/* Linear sRGB of an rgb value in the current colour space. `emitted`: a light, whose white stays what it is;
 * otherwise white stays white. Components may come out negative. */
rgb_t pbrt_srgb(const pbrt_t *p, rgb_t rgb, bool emitted);
/* What white, (1, 1, 1), becomes when a film is balanced to daylight of a temperature: by von Kries's rule in
 * Bradford's cone responses. */
rgb_t pbrt_white_balance(double kelvin);

/* lights.c */
result_t pbrt_area_light(pbrt_t *p, position_t at);
result_t pbrt_light(pbrt_t *p, position_t at);

/* light_images.c */
/* The mean over an image of the blob of its luminance times weight(context, s, t), where (s, t) is a pixel's
 * centre in [0, 1]^2 with the first row at t = 0; `weight` NULL: 1. */
double pbrt_image_mean(const pbrt_t *p, blob_ref_t image, double (*weight)(const void *, double, double),
                       const void *context);
/* A copy of an image with the mean of its colours as grey. */
blob_ref_t pbrt_grey_image(pbrt_t *p, blob_ref_t image);
/* An image of one white pixel. */
blob_ref_t pbrt_white_image(pbrt_t *p);

/* shapes.c */
result_t pbrt_shape(pbrt_t *p, position_t at);
/* What a Shape directive makes: the functions of shape_*.c append geometry in the space that `placed` leads
 * to and fill shape.kind, geometry and flags; geometry is BLOB_NONE when nothing is left of it. */
typedef struct {
    params_t *params;
    position_t at;
    affine_t placed; /* object from shape */
    size_t emitters; /* shapes that pbrt-v4 makes of it, each a light: triangles, patches, or 1 */
    double area;     /* after `placed`; 0 of curves */
    blob_shape_t shape;
} shape_work_t;

/* shape_mesh.c */
result_t pbrt_make_trianglemesh(pbrt_t *p, shape_work_t *work);
result_t pbrt_make_plymesh(pbrt_t *p, shape_work_t *work);
result_t pbrt_make_loopsubdiv(pbrt_t *p, shape_work_t *work);
result_t pbrt_make_heightfield(pbrt_t *p, shape_work_t *work);
result_t pbrt_make_bilinearmesh(pbrt_t *p, shape_work_t *work);
result_t pbrt_make_nurbs(pbrt_t *p, shape_work_t *work);
result_t pbrt_make_cone(pbrt_t *p, shape_work_t *work);
result_t pbrt_make_paraboloid(pbrt_t *p, shape_work_t *work);
result_t pbrt_make_hyperboloid(pbrt_t *p, shape_work_t *work);
/* shape_quadric.c */
result_t pbrt_make_sphere(pbrt_t *p, shape_work_t *work);
result_t pbrt_make_disk(pbrt_t *p, shape_work_t *work);
result_t pbrt_make_cylinder(pbrt_t *p, shape_work_t *work);
/* shape_curve.c */
result_t pbrt_make_curve(pbrt_t *p, shape_work_t *work);

/* arguments.c */
/* Reads a quoted string into p->arguments[slot], where it lives until the slot is read again. `what` says
 * what it is, for messages ("material"). */
result_t pbrt_read_string(pbrt_t *p, int slot, const char *what);
/* Reads `count` numbers, with or without brackets. */
result_t pbrt_read_numbers(pbrt_t *p, int count, double *numbers, const char *directive, position_t at);
/* Reads the parameters that follow into p->params. */
result_t pbrt_read_params(pbrt_t *p);
/* The same with the defaults of an Attribute directive behind them. */
result_t pbrt_read_params_for(pbrt_t *p, target_t target);
/* Reports the parameters nobody read: `kind` and `name` say whose ("Camera", "perspective"). */
result_t pbrt_finish_params(pbrt_t *p, const char *kind, const char *name);

#endif
