/* shapes: the Shape directive, and what the makers of its kinds get. */
#ifndef LIGHTMILL_PBRT_SHAPES_H
#define LIGHTMILL_PBRT_SHAPES_H

#include "client/import/pbrt/state/state.h"

result_t pbrt_shape(pbrt_t *p, position_t at);
/* What a Shape directive makes: the functions of shape_*.c append geometry in the space that `placed` leads
 * to and fill shape.kind, geometry and flags; geometry is BLOB_NONE when nothing is left of it. */
typedef struct {
    params_t *params;
    position_t at;
    affine_t placed;    /* object from shape */
    size_t emitters;    /* shapes that pbrt-v4 makes of it, each a light: triangles, quads, patches, or 1 */
    double area;        /* after `placed`; 0 of curves */
    bool inside_out;    /* its normal is not that which pbrt gives to where a ray hits it, but opposite */
    blob_ref_t outside; /* the medium outside of the interface in force */
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

#endif
