/* scattering: see scattering.h. */
#include "tests/scattering.h"

#include "common/sampler.h"
#include "tests/chi_square.h"
#include "worker/render/sampling/warp.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { DRAWS = 120000, ROWS = 20, COLUMNS = 40, CELLS = ROWS * COLUMNS, FINE = 12 };

void scattering_begin(scattering_t *scattering, blob_material_t material)
{
    scattering_begin_in(scattering, blob_builder_new(), material);
}

void scattering_begin_in(scattering_t *scattering, blob_builder_t *b, blob_material_t material)
{
    *scattering = (scattering_t){.bytes = NULL};
    blob_scene_t scene = blob_default_scene();
    /* With pbrt's default (u, v), dp/du is along x. */
    const vec3_t positions[] = {{-1, -1, 0}, {1, -1, 0}, {1, 1, 0}};
    const blob_triangle_t triangle = {{0, 1, 2}};
    const blob_mesh_t mesh = {.vertex_count = 3,
                              .first_normal = BLOB_NONE,
                              .first_uv = BLOB_NONE,
                              .first_uv2 = BLOB_NONE,
                              .first_colour = BLOB_NONE,
                              .triangle_count = 1};
    const blob_shape_t shape = {
        .kind = SHAPE_MESH, .light = BLOB_NONE, .alpha = blob_constant(1), .shadow_alpha = blob_constant(1)};
    blob_builder_add(b, BLOB_SECTION_SCENE, &scene, 1);
    blob_builder_add(b, BLOB_SECTION_POSITIONS, positions, 3);
    blob_builder_add(b, BLOB_SECTION_TRIANGLES, &triangle, 1);
    blob_builder_add(b, BLOB_SECTION_MESHES, &mesh, 1);
    const blob_texture_t tilted = {.kind = TEXTURE_SCALE,
                                   .channel = CHANNEL_RGB,
                                   .texture_from_world = xform_identity(),
                                   .inputs = {blob_colour_value(vec3(0.7f, 0.4f, 1)), blob_constant(1)}};
    blob_builder_add(b, BLOB_SECTION_TEXTURES, &tilted, 1);
    blob_builder_add(b, BLOB_SECTION_MATERIALS, &material, 1);
    blob_builder_add(b, BLOB_SECTION_SHAPES, &shape, 1);
    blob_builder_add(b, BLOB_SECTION_OBJECTS, &(blob_object_t){0, 1}, 1);
    uint64_t size;
    result_t made = blob_builder_finish(b, &scattering->bytes, &size);
    if (made.code != RESULT_OK) fail_msg("%s", made.message);
    blob_builder_destroy(&b);
    assert_int_equal(blob_open(scattering->bytes, size, &scattering->blob).code, RESULT_OK);
    assert_int_equal(scene_new(&scattering->blob, &scattering->scene).code, RESULT_OK);
    surface_t surface;
    assert_true(scene_intersect(scattering->scene, vec3(0.5f, -0.25f, 1), vec3(0, 0, -1), 0, &surface));
    material_bsdf(scattering->scene, &surface, &scattering->bsdf);
    assert_float_equal(scattering->bsdf.ns.z, 1, 1e-6f);
    if (material.values[VALUE_ANISOTROPIC].factor.x == 0) assert_float_equal(scattering->bsdf.s.x, 1, 1e-6f);
}

void scattering_end(scattering_t *scattering)
{
    scene_destroy(&scattering->scene);
    blob_close(&scattering->blob);
    free(scattering->bytes);
}

/* Equal solid angles: rows in cos theta, columns in phi. */
static size_t direction_cell(vec3_t w)
{
    double phi = atan2((double)w.y, (double)w.x);
    int row = (int)(((double)w.z + 1) / 2 * ROWS), column = (int)((phi + M_PI) / (2 * M_PI) * COLUMNS);
    row = row < 0 ? 0 : row >= ROWS ? ROWS - 1 : row;
    column = column < 0 ? 0 : column >= COLUMNS ? COLUMNS - 1 : column;
    return (size_t)row * COLUMNS + (size_t)column;
}

static double expected_in_cell(const bsdf_t *bsdf, vec3_t wo, int row, int column)
{
    double sum = 0, area = 4 * M_PI / ((double)CELLS * FINE * FINE);
    for (int i = row * FINE; i < (row + 1) * FINE; i++)
        for (int j = column * FINE; j < (column + 1) * FINE; j++) {
            double z = -1 + 2 * (i + 0.5) / (ROWS * FINE),
                   phi = 2 * M_PI * (j + 0.5) / (COLUMNS * FINE) - M_PI;
            vec3_t wi = scattering_direction((float)z, (float)phi);
            bsdf_value_t value;
            if (bsdf_eval(bsdf, wo, wi, TRANSPORT_RADIANCE, &value)) sum += (double)value.pdf * area * DRAWS;
        }
    return sum;
}

void scattering_check_draws(const bsdf_t *bsdf, vec3_t wo)
{
    double *observed = calloc(CELLS, sizeof *observed), *expected = calloc(CELLS, sizeof *expected);
    for (uint32_t i = 0; i < DRAWS; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 1, 0, i);
        bsdf_sample_t sample;
        vec2_t u = sampler_2d(&sampler);
        if (bsdf_sample(bsdf, wo, u, sampler_1d(&sampler), TRANSPORT_RADIANCE, &sample) && !sample.specular)
            observed[direction_cell(sample.wi)]++;
    }
    for (int row = 0; row < ROWS; row++)
        for (int column = 0; column < COLUMNS; column++)
            expected[row * COLUMNS + column] = expected_in_cell(bsdf, wo, row, column);
    double p = chi_square_p(observed, expected, CELLS, DRAWS);
    free(observed);
    free(expected);
    if (!(p > 1e-5)) fail_msg("p = %g for wo = %g %g %g", p, (double)wo.x, (double)wo.y, (double)wo.z);
}

void scattering_check_densities(const bsdf_t *bsdf)
{
    int compared = 0;
    for (uint32_t i = 0; i < 3000; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 2, 0, i);
        vec3_t wo = warp_sphere(sampler_2d(&sampler));
        vec2_t u = sampler_2d(&sampler);
        bsdf_sample_t sample;
        bsdf_value_t there, back;
        if (fabsf(wo.z) < 0.02f ||
            !bsdf_sample(bsdf, wo, u, sampler_1d(&sampler), TRANSPORT_RADIANCE, &sample) || sample.specular ||
            fabsf(sample.wi.z) < 0.02f)
            continue;
        assert_true(bsdf_eval(bsdf, wo, sample.wi, TRANSPORT_RADIANCE, &there));
        assert_true(bsdf_eval(bsdf, sample.wi, wo, TRANSPORT_IMPORTANCE, &back));
        assert_float_equal(sample.pdf / there.pdf, 1, 5e-3f);
        assert_float_equal(sample.pdf_rev / there.pdf_rev, 1, 5e-3f);
        assert_float_equal(there.pdf_rev / back.pdf, 1, 5e-3f);
        assert_float_equal(there.pdf / back.pdf_rev, 1, 5e-3f);
        compared++;
    }
    assert_true(compared > 300);
}

void scattering_check_finite(const bsdf_t *bsdf, uint32_t index, float grazing)
{
    sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 31, index, 0);
    for (int j = 0; j < 20; j++) {
        vec3_t wo = j < 2 ? scattering_direction(grazing, (float)j) : warp_sphere(sampler_2d(&sampler));
        bsdf_sample_t sample;
        bsdf_value_t value;
        vec2_t u = sampler_2d(&sampler);
        if (bsdf_sample(bsdf, wo, u, sampler_1d(&sampler), TRANSPORT_RADIANCE, &sample)) {
            assert_true(v_is_finite(sample.weight) && sample.weight.x >= 0);
            assert_true(sample.pdf > 0 && isfinite(sample.pdf));
        }
        if (!bsdf_eval(bsdf, wo, warp_sphere(u), TRANSPORT_RADIANCE, &value)) continue;
        assert_true(v_is_finite(value.f) && value.f.x >= 0);
        assert_true(isfinite(value.pdf) && isfinite(value.pdf_rev));
    }
}

scattering_mean_t scattering_albedo(const bsdf_t *bsdf, vec3_t wo, transport_t mode, uint32_t samples)
{
    double sum = 0, squares = 0, n = samples;
    for (uint32_t i = 0; i < samples; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 3, 0, i);
        bsdf_sample_t sample;
        vec2_t u = sampler_2d(&sampler);
        if (!bsdf_sample(bsdf, wo, u, sampler_1d(&sampler), mode, &sample)) continue;
        sum += (double)sample.weight.x;
        squares += (double)sample.weight.x * (double)sample.weight.x;
    }
    return (scattering_mean_t){sum / n, sqrt(fmax(0, squares / n - sum / n * (sum / n)) / n)};
}
