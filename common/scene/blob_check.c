/* blob_check: what the records of a blob may say (see blob_layout.h). A blob that passes cannot take the
 * renderer out of bounds. */
#include "common/scene/blob_layout.h"

#include <stdlib.h>

static bool xform_is_finite(const xform_t *t)
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 4; j++)
            if (!isfinite(t->m[i][j])) return false;
    return true;
}

static bool xform_is_usable(const xform_t *t)
{
    xform_t inverse;
    return xform_is_finite(t) && xform_invert(t, &inverse);
}

static bool all_finite(const float *values, int count)
{
    for (int i = 0; i < count; i++)
        if (!isfinite(values[i])) return false;
    return true;
}

static bool rgb_is_valid(rgb_t c)
{
    return v_is_finite(c) && c.x >= 0 && c.y >= 0 && c.z >= 0;
}

static bool is_one_of(uint32_t kind, uint32_t first, uint32_t end)
{
    return kind >= first && kind < end;
}

/* A reference to one of `count` things, or to none. */
static bool ref_is_valid(blob_ref_t ref, uint64_t count)
{
    return ref <= count;
}

/* Textures before the one with this index; all of them are allowed outside textures. */
static bool value_is_valid(const blob_value_t *value, uint64_t textures)
{
    return v_is_finite(value->factor) && ref_is_valid(value->texture, textures);
}

static result_t check_camera(const blob_scene_t *scene)
{
    CHECK(is_one_of(scene->camera, CAMERA_PERSPECTIVE, CAMERA_REALISTIC + 1), "unknown camera %u",
          scene->camera);
    CHECK(xform_is_usable(&scene->world_from_camera) && xform_is_usable(&scene->world_from_camera_end),
          "the camera's transform is singular or not finite");
    CHECK(scene->fov > 0 && scene->fov < 180, "the camera's fov is %g degrees, must be between 0 and 180",
          (double)scene->fov);
    CHECK(scene->lens_radius >= 0 && isfinite(scene->lens_radius), "the camera's lens radius is negative");
    CHECK(scene->focal_distance > 0 && isfinite(scene->focal_distance),
          "the camera's focal distance must be positive");
    const float *w = scene->screen_window, *film = scene->film_window;
    bool automatic = w[0] == 0 && w[1] == 0 && w[2] == 0 && w[3] == 0;
    CHECK(all_finite(w, 4), "the camera's screen window is not finite");
    CHECK(automatic || (w[0] < w[1] && w[2] < w[3]), "the camera's screen window is empty");
    CHECK(all_finite(film, 4) && film[0] < film[1] && film[2] < film[3] && fabsf(film[0]) < 1e3f &&
              fabsf(film[1]) < 1e3f && fabsf(film[2]) < 1e3f && fabsf(film[3]) < 1e3f,
          "the film's window is empty");
    return result_ok();
}

/* The lens of a camera that has one. Any that passes can be traced, if with no light behind it. */
static result_t check_lens(const scene_blob_t *blob)
{
    uint64_t count = blob->counts[BLOB_SECTION_LENS], pupils = blob->counts[BLOB_SECTION_PUPILS];
    const float *w = blob->scene->screen_window, exposure = blob->scene->lens_exposure;
    if (blob->scene->camera != CAMERA_REALISTIC) {
        CHECK(count == 0 && pupils == 0, "has a lens, but its camera takes none");
        return result_ok();
    }
    CHECK(count > 0 && count <= LENS_MAX_ELEMENTS, "its lens has %llu elements, must have 1 to %d",
          (unsigned long long)count, LENS_MAX_ELEMENTS);
    CHECK(pupils == LENS_PUPILS, "its lens has %llu pupils, must have %d", (unsigned long long)pupils,
          LENS_PUPILS);
    CHECK(w[0] < w[1], "the film behind its lens has no size");
    CHECK(exposure >= 0 && isfinite(exposure), "the exposure of its lens is negative or infinite");
    blob_ref_t aperture = blob->scene->aperture;
    CHECK(ref_is_valid(aperture, blob->counts[BLOB_SECTION_IMAGES]), "its lens has no image %u", aperture);
    CHECK(aperture == 0 || blob->images[aperture - 1].format == TEXELS_R32F,
          "the image of its lens's aperture is not of grey floats");
    for (uint64_t i = 0; i < count; i++) {
        const blob_lens_element_t *e = &blob->lens[i];
        CHECK(isfinite(e->curvature_radius) && isfinite(e->thickness) && isfinite(e->eta) && e->eta > 0 &&
                  isfinite(e->aperture_radius) && e->aperture_radius > 0,
              "lens element %llu is malformed", (unsigned long long)i);
    }
    CHECK(blob->lens[count - 1].thickness > 0, "the film does not lie behind the lens");
    for (uint64_t i = 0; i < pupils; i++)
        CHECK(all_finite(&blob->pupils[i].x_min, 4), "pupil %llu is not finite", (unsigned long long)i);
    return result_ok();
}

static result_t check_scene(const scene_blob_t *blob)
{
    CHECK(blob->counts[BLOB_SECTION_SCENE] == 1, "must have one scene record, has %llu",
          (unsigned long long)blob->counts[BLOB_SECTION_SCENE]);
    const blob_scene_t *scene = blob->scene;
    TRY(check_camera(scene));
    TRY(check_lens(blob));
    const blob_filter_t *filter = &scene->filter;
    CHECK(is_one_of(filter->kind, FILTER_BOX, FILTER_SINC + 1), "unknown pixel filter %u", filter->kind);
    CHECK(filter->radius_x > 0 && filter->radius_x <= 32 && filter->radius_y > 0 && filter->radius_y <= 32,
          "the pixel filter's radius must be over 0 and at most 32 pixels");
    CHECK(all_finite(filter->parameters, 2), "the pixel filter's parameters are not finite");
    CHECK((filter->kind != FILTER_GAUSSIAN && filter->kind != FILTER_SINC) || filter->parameters[0] > 0,
          "the pixel filter's parameter must be positive");
    CHECK(scene->max_luminance > 0, "the largest luminance of a sample must be positive");
    CHECK(scene->occlusion_distance > 0, "the distance of ambient occlusion must be positive");
    CHECK(rgb_is_valid(scene->occlusion_radiance),
          "the radiance of ambient occlusion is negative or infinite");
    CHECK(scene->regularize <= 1, "regularize must be 0 or 1");
    CHECK(ref_is_valid(scene->medium, blob->counts[BLOB_SECTION_MEDIA]), "the camera stands in no medium %u",
          scene->medium);
    job_settings_t settings = blob_default_settings(blob);
    result_t checked = job_settings_check(&settings);
    CHECK(checked.code == RESULT_OK, "%s", checked.message);
    return result_ok();
}

static result_t check_vectors(const char *what, const vec3_t *v, uint64_t count)
{
    for (uint64_t i = 0; i < count; i++)
        CHECK(v_is_finite(v[i]), "%s %llu is not finite", what, (unsigned long long)i);
    return result_ok();
}

/* As range_inside, for a range that may be absent. */
static bool range_inside_or_none(uint32_t first, uint64_t count, uint64_t total)
{
    return first == BLOB_NONE || range_inside(first, count, total);
}

static result_t check_mesh_arrays(const scene_blob_t *blob, const blob_mesh_t *mesh, unsigned long long id)
{
    uint32_t count = mesh->vertex_count;
    CHECK(mesh->steps != 1 && mesh->steps <= BLOB_MAX_STEPS, "mesh %llu: is given at %u times", id,
          mesh->steps);
    uint64_t placed = blob_mesh_places(mesh);
    CHECK(range_inside(mesh->first_position, placed, blob->counts[BLOB_SECTION_POSITIONS]),
          "mesh %llu: its vertices lie outside the positions", id);
    CHECK(range_inside_or_none(mesh->first_normal, placed, blob->counts[BLOB_SECTION_NORMALS]),
          "mesh %llu: its normals lie outside the normals", id);
    CHECK(mesh->first_tangent == 0 ||
              range_inside(mesh->first_tangent - 1, 2 * placed, blob->counts[BLOB_SECTION_NORMALS]),
          "mesh %llu: its tangents lie outside the normals", id);
    CHECK(range_inside_or_none(mesh->first_uv, count, blob->counts[BLOB_SECTION_UVS]) &&
              range_inside_or_none(mesh->first_uv2, count, blob->counts[BLOB_SECTION_UVS]),
          "mesh %llu: its uvs lie outside the uvs", id);
    CHECK(range_inside_or_none(mesh->first_colour, count, blob->counts[BLOB_SECTION_COLOURS]),
          "mesh %llu: its colours lie outside the colours", id);
    return result_ok();
}

/* Meshes own their triangles: ranges follow one another, so that the checks are linear in the blob's size. */
static result_t check_meshes(const scene_blob_t *blob)
{
    uint64_t next_triangle = 0;
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_MESHES]; i++) {
        const blob_mesh_t *mesh = &blob->meshes[i];
        unsigned long long id = i;
        TRY(check_mesh_arrays(blob, mesh, id));
        CHECK(mesh->triangle_count > 0 && mesh->first_triangle >= next_triangle &&
                  range_inside(mesh->first_triangle, mesh->triangle_count,
                               blob->counts[BLOB_SECTION_TRIANGLES]),
              "mesh %llu: its triangles lie outside the triangles, or are another mesh's", id);
        next_triangle = (uint64_t)mesh->first_triangle + mesh->triangle_count;
        const blob_triangle_t *triangle = blob->triangles + mesh->first_triangle;
        for (uint32_t t = 0; t < mesh->triangle_count; t++)
            for (int k = 0; k < 3; k++)
                CHECK(triangle[t].v[k] < mesh->vertex_count, "mesh %llu: triangle %u uses vertex %u of %u",
                      id, t, triangle[t].v[k], mesh->vertex_count);
    }
    return result_ok();
}

static result_t check_quadrics(const scene_blob_t *blob)
{
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_QUADRICS]; i++) {
        const blob_quadric_t *q = &blob->quadrics[i];
        unsigned long long id = i;
        CHECK(is_one_of(q->kind, QUADRIC_SPHERE, QUADRIC_CYLINDER + 1), "quadric %llu: unknown kind %u", id,
              q->kind);
        CHECK(q->radius > 0 && isfinite(q->radius), "quadric %llu: its radius must be positive", id);
        CHECK(isfinite(q->z_min) && isfinite(q->z_max) && q->phi_max > 0 && q->phi_max <= TWO_PI_F,
              "quadric %llu: its extent is not finite or empty", id);
        CHECK(q->kind == QUADRIC_DISK ? q->inner_radius >= 0 && q->inner_radius < q->radius
                                      : q->z_min < q->z_max,
              "quadric %llu: its extent is empty", id);
        CHECK(q->kind != QUADRIC_SPHERE || (q->z_min >= -q->radius && q->z_max <= q->radius),
              "quadric %llu: its z range lies outside its radius", id);
        CHECK(xform_is_usable(&q->object_from_quadric),
              "quadric %llu: its transform is singular or not finite", id);
    }
    return result_ok();
}

bool blob_segment_is_traceable(const blob_curve_point_t points[4])
{
    const float least = 1e-30f;
    float size = 0;
    for (int i = 0; i < 4; i++) {
        const blob_curve_point_t *p = &points[i], *q = &points[0];
        float away = fmaxf(fmaxf(fabsf(p->x - q->x), fabsf(p->y - q->y)), fabsf(p->z - q->z));
        size = fmaxf(size, fmaxf(away, p->radius));
    }
    return size == 0 || size >= least;
}

bool blob_instance_is_traceable(const xform_t *start, const xform_t *end)
{
    const float shortest = 1e-10f, longest = 1e10f, flattest = 1e-5f;
    /* The stretch changes in straight lines (motion_between), so that its ratios stay between those of the
     * ends: the lesser of each factor of the volume holds on the whole way. */
    float least_sine = 1, least_height = 1;
    const xform_t *ends[] = {start, end};
    for (int k = 0; k < 2; k++) {
        xform_t inverse;
        vec3_t axes[3];
        for (int i = 0; i < 3; i++) {
            axes[i] = vec3(ends[k]->m[0][i], ends[k]->m[1][i], ends[k]->m[2][i]);
            float length = v_length(axes[i]);
            if (!(length >= shortest && length <= longest)) return false;
            axes[i] = v_scale(axes[i], 1 / length);
        }
        vec3_t normal = v_cross(axes[0], axes[1]);
        float sine = v_length(normal);
        if (!(sine >= flattest) || !xform_invert(ends[k], &inverse)) return false;
        least_sine = float_min(least_sine, sine);
        least_height = float_min(least_height, fabsf(v_dot(normal, axes[2])) / sine);
    }
    return least_sine * least_height >= flattest;
}

static result_t check_curves(const scene_blob_t *blob)
{
    uint64_t points = blob->counts[BLOB_SECTION_CURVE_POINTS], next = 0;
    for (uint64_t i = 0; i < points; i++) {
        const blob_curve_point_t *p = &blob->curve_points[i];
        CHECK(isfinite(p->x) && isfinite(p->y) && isfinite(p->z) && p->radius >= 0 && isfinite(p->radius),
              "curve point %llu is not finite", (unsigned long long)i);
    }
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_CURVES]; i++) {
        const blob_curves_t *curves = &blob->curves[i];
        unsigned long long id = i;
        uint64_t count = 4 * (uint64_t)curves->segment_count;
        CHECK(is_one_of(curves->kind, CURVES_ROUND, CURVES_FLAT_FIBRE + 1), "curves %llu: unknown kind %u",
              id, curves->kind);
        CHECK(count > 0 && curves->first_point >= next && range_inside(curves->first_point, count, points),
              "curves %llu: its points lie outside the points, or are another's", id);
        next = curves->first_point + count;
        CHECK(curves->kind != CURVES_RIBBON
                  ? curves->first_normal == BLOB_NONE
                  : range_inside(curves->first_normal, count, blob->counts[BLOB_SECTION_NORMALS]),
              "curves %llu: its normals lie outside the normals", id);
        for (uint32_t s = 0; s < curves->segment_count; s++)
            CHECK(blob_segment_is_traceable(blob->curve_points + curves->first_point + 4 * (size_t)s),
                  "curves %llu: segment %u is smaller than 1e-30", id, s);
    }
    return result_ok();
}

static result_t check_interface(const scene_blob_t *blob, const blob_shape_t *shape, unsigned long long id)
{
    uint64_t media = blob->counts[BLOB_SECTION_MEDIA];
    bool parts = (shape->flags & SHAPE_INTERFACE) != 0;
    CHECK(ref_is_valid(shape->media[0], parts ? media : 0) &&
              ref_is_valid(shape->media[1], parts ? media : 0),
          "shape %llu: parts media that it cannot part", id);
    CHECK(blob->materials[shape->material].kind != MATERIAL_INTERFACE ||
              (parts && shape->media[0] != shape->media[1] && shape->light == BLOB_NONE &&
               shape->kind != SHAPE_CURVES),
          "shape %llu: is nothing but the border of media, which such a shape cannot be", id);
    return result_ok();
}

static result_t check_shapes(const scene_blob_t *blob)
{
    static const blob_section_t sections[] = {[SHAPE_MESH] = BLOB_SECTION_MESHES,
                                              [SHAPE_QUADRIC] = BLOB_SECTION_QUADRICS,
                                              [SHAPE_CURVES] = BLOB_SECTION_CURVES};
    uint64_t textures = blob->counts[BLOB_SECTION_TEXTURES];
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_SHAPES]; i++) {
        const blob_shape_t *shape = &blob->shapes[i];
        unsigned long long id = i;
        CHECK(is_one_of(shape->kind, SHAPE_MESH, SHAPE_CURVES + 1), "shape %llu: unknown kind %u", id,
              shape->kind);
        CHECK(shape->geometry < blob->counts[sections[shape->kind]], "shape %llu: no geometry %u", id,
              shape->geometry);
        CHECK(shape->material < blob->counts[BLOB_SECTION_MATERIALS], "shape %llu: no material %u", id,
              shape->material);
        CHECK(shape->light == BLOB_NONE ||
                  (shape->light < blob->counts[BLOB_SECTION_LIGHTS] &&
                   blob->lights[shape->light].kind == LIGHT_AREA && blob->lights[shape->light].shape == id),
              "shape %llu: light %u does not belong to it", id, shape->light);
        CHECK(shape->light == BLOB_NONE || shape->kind != SHAPE_CURVES, "shape %llu: curves cannot emit", id);
        CHECK(shape->kind != SHAPE_CURVES || !curves_are_fibres(blob->curves[shape->geometry].kind) ||
                  blob->materials[shape->material].kind == MATERIAL_HAIR,
              "shape %llu: is of fibres, and its material is not hair", id);
        CHECK(shape->light == BLOB_NONE || shape->kind != SHAPE_MESH ||
                  blob->meshes[shape->geometry].steps == 0,
              "shape %llu: a mesh that changes cannot emit", id);
        CHECK(shape->kind == SHAPE_MESH || !(shape->flags & SHAPE_BUMPS_V3),
              "shape %llu: is no mesh, and has the bumps of one", id);
        CHECK(shape->name < blob->counts[BLOB_SECTION_STRINGS],
              "shape %llu: its name lies outside the strings", id);
        TRY(check_interface(blob, shape, id));
        CHECK(value_is_valid(&shape->alpha, textures) && value_is_valid(&shape->shadow_alpha, textures),
              "shape %llu: its alpha is not finite or has no such texture", id);
    }
    return result_ok();
}

static result_t check_objects(const scene_blob_t *blob)
{
    uint64_t next = 0, shapes = blob->counts[BLOB_SECTION_SHAPES];
    CHECK(blob->counts[BLOB_SECTION_OBJECTS] > 0, "has no world object");
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_OBJECTS]; i++) {
        const blob_object_t *object = &blob->objects[i];
        CHECK(object->first_shape == next && range_inside(object->first_shape, object->shape_count, shapes),
              "object %llu: its shapes lie outside the shapes, or are another object's",
              (unsigned long long)i);
        next += object->shape_count;
    }
    CHECK(next == shapes, "objects hold %llu shapes of %llu", (unsigned long long)next,
          (unsigned long long)shapes);
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_INSTANCES]; i++) {
        const blob_instance_t *instance = &blob->instances[i];
        CHECK(instance->object > 0 && instance->object < blob->counts[BLOB_SECTION_OBJECTS],
              "instance %llu: no object %u", (unsigned long long)i, instance->object);
        CHECK(blob_instance_is_traceable(&instance->world_from_object, &instance->world_from_object_end),
              "instance %llu: its transform is close to singular, too small, too large or not finite",
              (unsigned long long)i);
        CHECK((xform_determinant(&instance->world_from_object) < 0) ==
                  (xform_determinant(&instance->world_from_object_end) < 0),
              "instance %llu: it turns inside out on its way", (unsigned long long)i);
    }
    return result_ok();
}

static result_t check_images(const scene_blob_t *blob)
{
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_IMAGES]; i++) {
        const blob_image_t *image = &blob->images[i];
        unsigned long long id = i;
        CHECK(is_one_of(image->format, TEXELS_R8, TEXELS_RGB32F + 1), "image %llu: unknown format %u", id,
              image->format);
        CHECK(image->width > 0 && image->width <= BLOB_MAX_IMAGE_SIDE && image->height > 0 &&
                  image->height <= BLOB_MAX_IMAGE_SIDE,
              "image %llu: %u x %u pixels", id, image->width, image->height);
        uint64_t size = (uint64_t)image->width * image->height * blob_texel_bytes(image->format);
        CHECK(range_inside(image->first_word, (size + 3) / 4, blob->counts[BLOB_SECTION_TEXELS]),
              "image %llu: its pixels lie outside the texels", id);
        CHECK(image->gamma >= 0 && image->gamma <= 10, "image %llu: its gamma must be from 0 to 10", id);
        const float *floats = (const float *)(blob->texels + image->first_word);
        bool is_float = image->format == TEXELS_R32F || image->format == TEXELS_RGB32F;
        for (uint64_t k = 0; is_float && k < size / 4; k++)
            CHECK(isfinite(floats[k]), "image %llu: a pixel is not finite", id);
    }
    return result_ok();
}

/* Every texture refers to earlier ones alone, so that there is no cycle; the cost of one look-up is bounded
 * by counting the textures that it evaluates. */
static result_t check_textures(const scene_blob_t *blob)
{
    uint64_t count = blob->counts[BLOB_SECTION_TEXTURES];
    double *costs = mem_zalloc(count + 1, sizeof *costs);
    result_t result = result_ok();
    for (uint64_t i = 0; i < count && result.code == RESULT_OK; i++) {
        const blob_texture_t *t = &blob->textures[i];
        bool valid = is_one_of(t->kind, TEXTURE_IMAGE, TEXTURE_KIND_END) && t->mapping <= MAPPING_CYLINDER &&
                     t->channel <= CHANNEL_MEAN && t->wrap_s <= WRAP_MIRROR && t->wrap_t <= WRAP_MIRROR &&
                     ref_is_valid(t->image, blob->counts[BLOB_SECTION_IMAGES]) &&
                     (t->kind != TEXTURE_IMAGE || t->image != 0) && all_finite(&t->matrix[0][0], 6) &&
                     xform_is_finite(&t->texture_from_world) && all_finite(t->parameters, TEXTURE_PARAMETERS);
        costs[i] = 1;
        for (int k = 0; k < TEXTURE_INPUTS && valid; k++) {
            valid = value_is_valid(&t->inputs[k], i);
            if (valid && t->inputs[k].texture != 0) costs[i] += costs[t->inputs[k].texture - 1];
        }
        if (!valid)
            result =
                result_fail(RESULT_INPUT, "scene blob: texture %llu is malformed", (unsigned long long)i);
        else if (costs[i] > BLOB_MAX_TEXTURE_COST)
            result = result_fail(RESULT_INPUT, "scene blob: texture %llu combines more than %d textures",
                                 (unsigned long long)i, BLOB_MAX_TEXTURE_COST);
    }
    free(costs);
    return result;
}

static result_t check_materials(const scene_blob_t *blob)
{
    uint64_t count = blob->counts[BLOB_SECTION_MATERIALS], textures = blob->counts[BLOB_SECTION_TEXTURES];
    uint8_t *depths = mem_zalloc(count + 1, 1);
    result_t result = result_ok();
    for (uint64_t i = 0; i < count && result.code == RESULT_OK; i++) {
        const blob_material_t *m = &blob->materials[i];
        bool valid = is_one_of(m->kind, MATERIAL_DIFFUSE, MATERIAL_KIND_END) &&
                     m->name < blob->counts[BLOB_SECTION_STRINGS] && ref_is_valid(m->normal_map, textures) &&
                     ref_is_valid(m->bump, textures) && isfinite(m->normal_scale) &&
                     ref_is_valid(m->body, blob->counts[BLOB_SECTION_MEDIA]) &&
                     ref_is_valid(m->coat_normal_map, textures) && isfinite(m->coat_normal_scale);
        for (int k = 0; k < MATERIAL_VALUES && valid; k++)
            valid = value_is_valid(&m->values[k], textures) &&
                    ref_is_valid(m->values[k].spectrum, blob->counts[BLOB_SECTION_SPECTRA]);
        if (valid && m->kind == MATERIAL_MIX) {
            valid = m->parts[0] < i && m->parts[1] < i &&
                    blob->materials[m->parts[0]].kind != MATERIAL_INTERFACE &&
                    blob->materials[m->parts[1]].kind != MATERIAL_INTERFACE;
            if (valid) depths[i] = (uint8_t)(1 + int_max(depths[m->parts[0]], depths[m->parts[1]]));
            valid = valid && depths[i] <= BLOB_MAX_MIX_DEPTH;
        }
        if (m->kind == MATERIAL_FOURIER) valid = valid && m->table < blob->counts[BLOB_SECTION_FOURIERS];
        if (m->kind == MATERIAL_MEASURED) valid = valid && m->table < blob->counts[BLOB_SECTION_MEASUREMENTS];
        if (!valid)
            result =
                result_fail(RESULT_INPUT, "scene blob: material %llu is malformed", (unsigned long long)i);
    }
    free(depths);
    return result;
}

/* The sides' lengths must also be such that their squares and products are numbers. */
static bool portal_is_valid(const vec3_t portal[3])
{
    const float shortest = 1e-9f, longest = 1e9f, most_cosine = 1e-5f;
    float a = v_length(portal[1]), b = v_length(portal[2]);
    return v_is_finite(portal[0]) && v_length(portal[0]) <= longest && a >= shortest && a <= longest &&
           b >= shortest && b <= longest && fabsf(v_dot(portal[1], portal[2])) <= most_cosine * a * b;
}

static result_t check_lights(const scene_blob_t *blob)
{
    const blob_object_t *world = &blob->objects[0];
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_LIGHTS]; i++) {
        const blob_light_t *light = &blob->lights[i];
        unsigned long long id = i;
        CHECK(is_one_of(light->kind, LIGHT_AREA, LIGHT_INFINITE + 1), "light %llu: unknown kind %u", id,
              light->kind);
        CHECK(rgb_is_valid(light->radiance.factor),
              "light %llu: its radiance must be finite and not negative", id);
        CHECK(ref_is_valid(light->radiance.spectrum, blob->counts[BLOB_SECTION_SPECTRA]),
              "light %llu: no spectrum %u", id, light->radiance.spectrum);
        CHECK(all_finite(light->parameters, 4), "light %llu: its parameters are not finite", id);
        CHECK(ref_is_valid(light->image, blob->counts[BLOB_SECTION_IMAGES]), "light %llu: no image %u", id,
              light->image);
        CHECK(ref_is_valid(light->medium, light->kind < LIGHT_DISTANT ? blob->counts[BLOB_SECTION_MEDIA] : 0),
              "light %llu: shines into no medium %u", id, light->medium);
        CHECK((light->flags & (LIGHT_UNSEEN | LIGHT_PICTURE)) == 0 || light->kind == LIGHT_AREA,
              "light %llu: only area lights are unseen, or pictures", id);
        if (light->kind == LIGHT_AREA) {
            CHECK(light->shape < world->shape_count && blob->shapes[light->shape].light == i,
                  "light %llu does not belong to a shape of the world", id);
            const blob_value_t *alpha = &blob->shapes[light->shape].alpha;
            CHECK((light->flags & LIGHT_UNSEEN) == 0 || (alpha->texture == 0 && alpha->factor.x == 0),
                  "light %llu: rays run into its shape, but it is to be unseen", id);
            CHECK((light->flags & LIGHT_PICTURE) == 0 ||
                      ((light->flags & LIGHT_UNSEEN) == 0 && blob->shapes[light->shape].kind == SHAPE_MESH),
                  "light %llu: only a mesh that is seen can be a picture", id);
            CHECK(value_is_valid(&light->radiance, blob->counts[BLOB_SECTION_TEXTURES]),
                  "light %llu: no such texture", id);
            continue;
        }
        CHECK(light->radiance.texture == 0, "light %llu: only area lights have textures", id);
        CHECK(xform_is_usable(&light->world_from_light),
              "light %llu: its transform is singular or not finite", id);
        CHECK(light->image == 0 || light->kind == LIGHT_PROJECTION ||
                  is_one_of(light->mapping, LIGHT_LATLONG, LIGHT_OCTAHEDRAL + 1),
              "light %llu: unknown mapping %u", id, light->mapping);
        CHECK((light->flags & LIGHT_PORTAL) == 0 || light->kind == LIGHT_INFINITE,
              "light %llu: only infinite lights have portals", id);
        CHECK((light->flags & LIGHT_PORTAL) == 0 || portal_is_valid(light->portal),
              "light %llu: its portal is no rectangle", id);
        CHECK((light->kind != LIGHT_GONIOMETRIC && light->kind != LIGHT_PROJECTION) || light->image != 0,
              "light %llu has no image", id);
        CHECK(light->kind != LIGHT_PROJECTION || (light->parameters[0] < light->parameters[1] &&
                                                  light->parameters[2] < light->parameters[3]),
              "light %llu: its window is empty", id);
        CHECK(light->kind != LIGHT_SPOT ||
                  (light->parameters[0] >= -1 && light->parameters[0] <= light->parameters[1] &&
                   light->parameters[1] <= 1 && light->parameters[0] < 1),
              "light %llu: its cone is empty", id);
    }
    return result_ok();
}

result_t blob_check_contents(const scene_blob_t *blob)
{
    uint64_t strings = blob->counts[BLOB_SECTION_STRINGS];
    CHECK(strings > 0 && blob->strings[0] == 0 && blob->strings[strings - 1] == 0,
          "its strings are not terminated");
    TRY(check_scene(blob));
    TRY(check_vectors("position", blob->positions, blob->counts[BLOB_SECTION_POSITIONS]));
    TRY(check_vectors("normal", blob->normals, blob->counts[BLOB_SECTION_NORMALS]));
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_UVS]; i++)
        CHECK(isfinite(blob->uvs[i].x) && isfinite(blob->uvs[i].y), "uv %llu is not finite",
              (unsigned long long)i);
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_COLOURS]; i++)
        CHECK(all_finite(&blob->colours[i].r, 4), "colour %llu is not finite", (unsigned long long)i);
    TRY(check_meshes(blob));
    TRY(check_quadrics(blob));
    TRY(check_curves(blob));
    TRY(check_images(blob));
    TRY(check_textures(blob));
    TRY(check_shapes(blob));
    TRY(check_objects(blob));
    TRY(blob_check_tables(blob));
    TRY(check_materials(blob));
    return check_lights(blob);
}
