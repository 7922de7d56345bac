/* What the OBJ importer makes of faces, names and materials, and what it says to files that are wrong. */
#include "tests/unit/client/import/test_import.h"

#include "client/import/files/polygon.h"
#include "common/base.h"
#include "worker/render/texture/texture.h"

#define SQUARE "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"

static void run(bench_t *bench, const char *obj, const char *mtl)
{
    bench_write(bench, "s.obj", obj, strlen(obj));
    if (mtl) bench_write(bench, "a.mtl", mtl, strlen(mtl));
    bench_import_file(bench, "s.obj");
}

/* A square of one material. */
static void run_material(bench_t *bench, const char *statements)
{
    char *mtl = mem_printf("newmtl m\n%s\n", statements);
    run(bench, "mtllib a.mtl\n" SQUARE "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3 4/4\n", mtl);
    free(mtl);
}

static const blob_material_t *material_of(const bench_t *bench, uint64_t shape)
{
    assert_true(shape < count_of(bench, BLOB_SECTION_SHAPES));
    return &bench->blob.materials[bench->blob.shapes[shape].material];
}

static double number(const bench_t *bench, material_value_t value)
{
    return (double)material_of(bench, 0)->values[value].factor.x;
}

static void expect_error(bench_t *bench, const char *obj, const char *text)
{
    run(bench, obj, NULL);
    assert_int_equal(bench->result.code, RESULT_INPUT);
    expect_text(bench->result.message, text);
}

static double area_of(const bench_t *bench, uint64_t shape)
{
    const blob_mesh_t *mesh = mesh_of(bench, shape);
    double area = 0;
    for (uint32_t i = 0; i < mesh->triangle_count; ++i) {
        vec3_t p[3];
        for (int k = 0; k < 3; ++k)
            p[k] =
                bench->blob
                    .positions[mesh->first_position + bench->blob.triangles[mesh->first_triangle + i].v[k]];
        area += (double)v_length(v_cross(v_sub(p[1], p[0]), v_sub(p[2], p[0]))) / 2;
    }
    return area;
}

/* ---- geometry ------------------------------------------------------------------------------------------ */

static void faces_share_vertices_that_have_the_same_indices(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, SQUARE "f 1 2 3\nf 1 3 4\n", NULL);
    bench_expect_ok(&bench);
    assert_int_equal(mesh_of(&bench, 0)->vertex_count, 4);
    assert_int_equal(mesh_of(&bench, 0)->triangle_count, 2);
    assert_int_equal(mesh_of(&bench, 0)->first_normal, BLOB_NONE);
    assert_int_equal(mesh_of(&bench, 0)->first_uv, BLOB_NONE);
    expect_near(area_of(&bench, 0), 1, 1e-6);
    bench_close(&bench);
}

static void corners_with_two_normals_are_two_vertices(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, SQUARE "vn 0 0 1\nvn 0 1 1\nvt .5 .25\nf 1//1 2//1 3//1\nf 1/1/2 3/1/1 4/1/1\n", NULL);
    bench_expect_ok(&bench);
    assert_int_equal(count_of(&bench, BLOB_SECTION_SHAPES), 1);
    assert_int_equal(mesh_of(&bench, 0)->vertex_count, 6); /* 3 differs by its texture coordinate */
    const vec3_t *normals = bench.blob.normals + mesh_of(&bench, 0)->first_normal;
    expect_vec3(normals[0], 0, 0, 1);
    expect_vec3(normals[3], 0, sqrt(0.5), sqrt(0.5));
    expect_near((double)bench.blob.uvs[mesh_of(&bench, 0)->first_uv + 3].y, 0.25, 0);
    bench_close(&bench);
}

static void negative_indices_count_back_from_the_line(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, "v 9 9 9\n" SQUARE "f -4 -3 -2 -1\nv 7 7 7\n", NULL);
    bench_expect_ok(&bench);
    expect_near(area_of(&bench, 0), 1, 1e-6);
    bench_close(&bench);
}

static void a_concave_face_is_cut_by_its_ears(void **state)
{
    (void)state;
    bench_t bench = {0};
    /* an arrow head whose fan about the first corner would overlap itself: 2 x 2 less a triangle of 1 */
#define ARROW "v 2 0 0\nv 2 2 0\nv 0 2 0\nv 0 0 0\nv 1 1 0\n"
    run(&bench, ARROW "f 1 2 3 4 5\n", NULL);
    bench_expect_ok(&bench);
    expect_near(area_of(&bench, 0), 3, 1e-6);
    run(&bench, ARROW "f 1 2 3 4 5 5\n", NULL); /* a corner that is there twice */
    expect_near(area_of(&bench, 0), 3, 1e-6);
    assert_null(strstr(bench.warnings, "crosses itself"));
    run(&bench, "v 0 0 0\nv 3 0 0\nv 3 3 0\nv 2 3 0\nv 2 1 0\nv 1 1 0\nv 1 3 0\nv 0 3 0\nf 1 2 3 4 5 6 7 8\n",
        NULL);
    expect_near(area_of(&bench, 0), 7, 1e-6); /* a U */
    bench_close(&bench);
}

static double area_of_triangle(vec3_t a, vec3_t b, vec3_t c)
{
    double u[2] = {(double)(b.x - a.x), (double)(b.y - a.y)},
           v[2] = {(double)(c.x - a.x), (double)(c.y - a.y)};
    return (u[0] * v[1] - u[1] * v[0]) / 2;
}

/* The triangles must cover the polygon once; the polygon lies in z = 0 and runs counter-clockwise. */
static void expect_cut(const vec3_t *corners, size_t count)
{
    uint32_t *t = mem_alloc(3 * (count - 2) * sizeof *t);
    uint64_t patience = (uint64_t)1 << 26;
    double area = 0, covered = 0;
    assert_true(polygon_cut(corners, count, t, &patience));
    for (size_t i = 0; i + 2 < count; ++i) {
        for (int k = 0; k < 3; ++k) assert_true(t[3 * i + (size_t)k] < count);
        area += area_of_triangle(corners[0], corners[i + 1], corners[i + 2]);
        covered += fabs(area_of_triangle(corners[t[3 * i]], corners[t[3 * i + 1]], corners[t[3 * i + 2]]));
    }
    expect_near(covered, area, 1e-4 * area);
    free(t);
}

static void faces_of_thousands_of_corners_are_cut_by_their_ears(void **state)
{
    enum { CORNERS = 4000 };
    (void)state;
    vec3_t *corners = mem_alloc(CORNERS * sizeof *corners);
    for (size_t count = 4; count <= CORNERS; count *= 10) {
        for (size_t i = 0; i < count; ++i) { /* teeth */
            float radius = i % 2 ? 1 : 2, angle = (float)i * TWO_PI_F / (float)count;
            corners[i] = vec3(radius * cosf(angle), radius * sinf(angle), 0);
        }
        expect_cut(corners, count);
        for (size_t i = 0; i < count; ++i) { /* a spiral, outward and back */
            size_t step = i < count / 2 ? i : count - 1 - i;
            float angle = 0.1f * (float)step, radius = 1 + 0.05f * angle + (i < count / 2 ? 0.1f : 0);
            corners[i] = vec3(radius * cosf(angle), radius * sinf(angle), 0);
        }
        expect_cut(corners, count);
    }
    free(corners);
}

static void a_face_may_have_a_hole_at_the_end_of_a_bridge(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench,
        "v 0 0 0\nv 0 4 0\nv 0 4 4\nv 0 0 4\nv 0 1 1\nv 0 1 3\nv 0 3 3\nv 0 3 1\nf 1 2 3 4 1 5 6 7 8 5\n",
        NULL);
    bench_expect_ok(&bench);
    assert_int_equal(bench.warning_count, 1); /* there is no light */
    assert_int_equal(mesh_of(&bench, 0)->triangle_count, 8);
    expect_near(area_of(&bench, 0), 12, 1e-5);
    bench_close(&bench);
}

static void faces_that_cannot_be_cut_are_told(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, "v -4 -4 0\nv 2 2 0\nv 2 -2 0\nv -4 4 0\nf 1 2 3 4\n", NULL); /* its sides cross */
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "s.obj:5: this face crosses itself, or has so many corners");
    vec3_t corners[100];
    uint32_t triangles[3 * 98];
    for (int i = 0; i < 100; ++i) {
        float radius = i % 2 ? 1 : 2, angle = (float)i * TWO_PI_F / 100;
        corners[i] = vec3(radius * cosf(angle), radius * sinf(angle), 0);
    }
    uint64_t patience = 300;
    assert_false(polygon_cut(corners, 100, triangles, &patience));
    assert_int_equal(patience, 0);
    for (int i = 0; i < 3 * 98; ++i) assert_true(triangles[i] < 100);
    bench_close(&bench);
}

static void parts_are_by_name_material_and_normals(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench,
        "mtllib a.mtl\n" SQUARE "vn 0 0 1\no one\nusemtl a\nf 1 2 3\nusemtl b\nf 1 3 4\nusemtl a\nf 2 3 4\n"
        "f 1//1 2//1 3//1\no two\nf 1 2 4\n",
        "newmtl a\nKd 1 0 0\nnewmtl b\nKd 0 1 0\n");
    bench_expect_ok(&bench);
    assert_int_equal(count_of(&bench, BLOB_SECTION_SHAPES), 4);
    assert_int_equal(count_of(&bench, BLOB_SECTION_MATERIALS), 2);
    assert_int_equal(mesh_of(&bench, 0)->triangle_count, 2);
    assert_string_equal(bench.blob.strings + bench.blob.shapes[0].name, "one");
    assert_string_equal(bench.blob.strings + bench.blob.shapes[3].name, "two");
    expect_vec3(material_of(&bench, 1)->values[VALUE_REFLECTANCE].factor, 0, 1, 0);
    assert_true(mesh_of(&bench, 2)->first_normal != BLOB_NONE);
    bench_close(&bench);
}

static void lines_may_be_joined_and_commented(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, "# v 1\r\n" SQUARE "usemtl Mat#1 # of Max\nf 1 2 \\\n 3 \\\r\n4\r\nl 1 2\ns off\n", NULL);
    bench_expect_ok(&bench);
    expect_near(area_of(&bench, 0), 1, 1e-6);
    expect_text(bench.warnings, "no library has the material \"Mat#1\"");
    expect_text(bench.warnings, "s.obj:10: points and lines");
    bench_close(&bench);
}

/* As many programs on Windows write text. */
static void a_byte_order_mark_is_no_part_of_a_line(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, "\xEF\xBB\xBFmtllib a.mtl\n" SQUARE "usemtl m\nf 1 2 3 4\n",
        "\xEF\xBB\xBFnewmtl m\nKd 1 0 0\n");
    bench_expect_ok(&bench);
    expect_vec3(material_of(&bench, 0)->values[VALUE_REFLECTANCE].factor, 1, 0, 0);
    assert_null(strstr(bench.warnings, "mtllib"));
    bench_close(&bench);
}

static void what_a_file_lacks_is_done_without(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, SQUARE "f 1/1/1 2/2/1 3/3/1\nf 1//7 3//7 4//7\n", NULL);
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "s.obj:5: corners do without the vt or vn of their indices");
    assert_int_equal(mesh_of(&bench, 0)->triangle_count, 2);
    assert_int_equal(mesh_of(&bench, 0)->first_normal, BLOB_NONE);
    assert_int_equal(mesh_of(&bench, 0)->first_uv, BLOB_NONE);
    run(&bench, SQUARE "vt 0 0\nvn 0 0 1\nf 1/1/1 2/2/1 3/1/-2\nf 1//1 3//1 4//1\n", NULL);
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "s.obj:7: corners do without the vt or vn of their indices");
    assert_int_equal(count_of(&bench, BLOB_SECTION_SHAPES), 2);
    assert_true(mesh_of(&bench, 0)->first_uv != BLOB_NONE && mesh_of(&bench, 1)->first_normal != BLOB_NONE);
    assert_int_equal(mesh_of(&bench, 0)->first_normal, BLOB_NONE);
    static const char *const nothing[] = {SQUARE, SQUARE "p 1 2\nl 3 4\n", SQUARE "f 1 1 2\n",
                                          SQUARE "f 1 2\nf 3\n"};
    for (size_t i = 0; i < ARRAY_LENGTH(nothing); ++i) {
        run(&bench, nothing[i], NULL);
        bench_expect_ok(&bench);
        expect_text(bench.warnings, "s.obj: the scene has no shape that could be rendered");
        assert_int_equal(count_of(&bench, BLOB_SECTION_SHAPES), 0);
    }
    bench_close(&bench);
}

static void what_is_wrong_is_named(void **state)
{
    (void)state;
    bench_t bench = {0};
    expect_error(&bench, "v 0 0\n", "s.obj:1:");
    expect_error(&bench, "v 0 0 nan\n", "expected a number, found \"nan\"");
    expect_error(&bench, SQUARE "f 1 2 5\n", "s.obj:5: \"5\" is no corner of a face");
    expect_error(&bench, SQUARE "f 0 1 2\n", "\"0\" is no corner");
    expect_error(&bench, SQUARE "f 1 2 -5\n", "\"-5\" is no corner");
    expect_error(&bench, SQUARE "f 1/0 2/1 3/1\n", "0 vt");
    expect_error(&bench, SQUARE "f 1 2x 3\n", "\"2x\" is no corner");
    expect_error(&bench, SQUARE "f 1/1/0 2/1/1 3/1/1\n", "0 vn");
    expect_error(&bench, "hello\nworld\n", "is it a Wavefront OBJ file?");
    expect_error(&bench, SQUARE "f 1 2 3\ncstype bezier\n", "free-form");
    bench.lenient = true;
    run(&bench, SQUARE "f 1 2 3\ncstype bezier\n", NULL);
    bench_expect_ok(&bench);
    bench_close(&bench);
}

/* ---- what a file does not say -------------------------------------------------------------------------- */

static void a_file_without_light_gets_a_sky_and_a_camera_and_is_told(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, SQUARE "f 1 2 3\n", NULL);
    expect_text(bench.warnings, "a white sky of radiance 1");
    assert_int_equal(count_of(&bench, BLOB_SECTION_LIGHTS), 1);
    assert_int_equal(bench.blob.lights[0].kind, LIGHT_INFINITE);
    assert_int_equal(bench.blob.scene->width, 1280);
    expect_near((double)bench.blob.scene->fov, 40, 0);
    assert_true(bench.blob.scene->world_from_camera.m[2][3] > 1);
    run_material(&bench, "Kd 1 1 1\nKe 2 3 4\n");
    bench_expect_ok(&bench);
    assert_int_equal(bench.warning_count, 1);
    expect_text(bench.warnings, "nothing lights the scene but its own surfaces");
    assert_int_equal(count_of(&bench, BLOB_SECTION_LIGHTS), 1);
    assert_int_equal(bench.blob.lights[0].kind, LIGHT_AREA);
    expect_vec3(bench.blob.lights[0].radiance.factor, 2, 3, 4);
    bench_close(&bench);
}

/* ---- materials ----------------------------------------------------------------------------------------- */

static void phong_becomes_what_reflects_as_much(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_material(&bench, "Kd .1 .2 .3\nKs .5 .5 .5\nillum 1\n");
    assert_int_equal(material_of(&bench, 0)->kind, MATERIAL_DIFFUSE);
    run_material(&bench, "Kd .1 .2 .3\nKs .5 .6 .7\nNs 198\nNi 1.6\nillum 2\n");
    assert_int_equal(material_of(&bench, 0)->kind, MATERIAL_GLTF);
    expect_vec3(material_of(&bench, 0)->values[VALUE_SPECULAR_COLOUR].factor, .5, .6, .7);
    expect_near(number(&bench, VALUE_ROUGHNESS_U), 0.1, 1e-6);
    expect_near(number(&bench, VALUE_ETA), 1.6, 1e-6);
    assert_int_equal(material_of(&bench, 0)->flags & MATERIAL_REMAP_SQUARE, 0);
    run_material(&bench, "Kd 0 0 0\nKs .9 .9 .9\nNs 1000\nillum 3\n");
    assert_true(number(&bench, VALUE_ETA) > 1000); /* all of Ks is reflected */
    run_material(&bench, "illum 7\nNi 1.33\nTf .9 1 1\n");
    assert_int_equal(material_of(&bench, 0)->kind, MATERIAL_DIELECTRIC);
    expect_near(number(&bench, VALUE_ETA), 1.33, 1e-6);
    expect_near(number(&bench, VALUE_TRANSMITTANCE), 0.9, 1e-6);
    expect_near(number(&bench, VALUE_ROUGHNESS_U), 0, 0);
    run_material(&bench, "Kd 1 .5 0\nPr .3\nPm 1\nPc .5\n");
    expect_near(number(&bench, VALUE_METALLIC), 1, 0);
    expect_near(number(&bench, VALUE_ROUGHNESS_U), 0.3, 1e-6);
    expect_near(number(&bench, VALUE_CLEARCOAT), 0.5, 0);
    assert_true((material_of(&bench, 0)->flags & MATERIAL_REMAP_SQUARE) != 0);
    bench_close(&bench);
}

static double alpha_of(bench_t *bench, const char *statements)
{
    run_material(bench, statements);
    bench_expect_ok(bench);
    return (double)bench->blob.shapes[0].alpha.factor.x;
}

static void opacity_is_d_or_the_rest_of_tr(void **state)
{
    (void)state;
    bench_t bench = {0};
    expect_near(alpha_of(&bench, "d .25"), 0.25, 0);
    expect_near(alpha_of(&bench, "Tr .25"), 0.75, 0);
    expect_near(alpha_of(&bench, "Tr .25\nd .5"), 0.5, 0);
    expect_near(alpha_of(&bench, "d -halo .5"), 0.5, 0);
    expect_near(alpha_of(&bench, "d .5\nillum 7\nNi 1.5"), 1, 0);
    expect_near(alpha_of(&bench, "Tr 1"), 1, 0);
    expect_text(bench.warnings, "a.mtl:1: Tr 1 would make it invisible");
    run_material(&bench, "d 0");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "no shape that could be rendered");
    bench_close(&bench);
}

static void write_tile(bench_t *bench, const char *name)
{
    uint8_t *bytes;
    size_t size;
    assert_int_equal(file_read("tests/fuzz/assets/tile.png", 1 << 20, &bytes, &size).code, RESULT_OK);
    bench_write(bench, name, bytes, size);
    free(bytes);
}

static void maps_lie_on_the_surface_as_their_options_say(void **state)
{
    (void)state;
    bench_t bench = {0};
    write_tile(&bench, "a b.png");
    run_material(&bench,
                 "Kd 0 0 0\nmap_Kd -s 2 3 1 -o .25 .5 -clamp on c:\\textures\\a b.png\nmap_d a b.png\n");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "is black, and taken for white");
    const blob_value_t *colour = &material_of(&bench, 0)->values[VALUE_REFLECTANCE];
    const blob_texture_t *texture = &bench.blob.textures[colour->texture - 1];
    expect_near((double)colour->factor.x, 1, 0);
    expect_near((double)texture->matrix[0][0], 2, 0);
    expect_near((double)texture->matrix[0][2], 0.25, 0);
    expect_near((double)texture->matrix[1][1], -3, 0);
    expect_near((double)texture->matrix[1][2], 0.5, 0);
    assert_int_equal(texture->wrap_s, WRAP_CLAMP);
    assert_true(bench.blob.shapes[0].alpha.texture != 0);
    run_material(&bench, "bump a b.png\n");
    expect_text(bench.warnings, "without a height");
    assert_int_equal(material_of(&bench, 0)->bump, 0);
    run_material(&bench, "bump -bm 0.02 a b.png\nnewmtl other\nmap_Kd missing.png\n");
    assert_true(material_of(&bench, 0)->bump != 0);
    run_material(&bench, "norm a b.png\n");
    assert_true(material_of(&bench, 0)->normal_map != 0);
    bench_close(&bench);
}

/* Else each triangle would show all of the image. */
static void an_image_without_texture_coordinates_is_one_texel(void **state)
{
    (void)state;
    bench_t bench = {0};
    static const char *const mapped[] = {"map_Kd a.png\n", "map_d a.png\n", "norm a.png\n", "map_Ke a.png\n"};
    write_tile(&bench, "a.png");
    for (size_t i = 0; i < ARRAY_LENGTH(mapped); ++i) {
        char *mtl = mem_printf("newmtl m\n%s", mapped[i]);
        run(&bench, "mtllib a.mtl\n" SQUARE "usemtl m\nf 1 2 3 4\n", mtl);
        free(mtl);
        bench_expect_ok(&bench);
        assert_true(mesh_of(&bench, 0)->first_uv != BLOB_NONE);
        for (uint32_t k = 0; k < 4; ++k) {
            vec2_t uv = bench.blob.uvs[mesh_of(&bench, 0)->first_uv + k];
            assert_true(uv.x == 0 && uv.y == 0);
        }
    }
    run(&bench, "mtllib a.mtl\n" SQUARE "usemtl m\nf 1 2 3 4\n", "newmtl m\nKd 1 0 0\n");
    assert_int_equal(mesh_of(&bench, 0)->first_uv, BLOB_NONE);
    bench_close(&bench);
}

static void opacity_is_the_alpha_of_grey_images_as_well(void **state)
{
    (void)state;
    bench_t bench = {0};
    const uint8_t file[18 + 4] = {[2] = 3, [12] = 2, [14] = 1, [16] = 16, [18] = 9, 255, 7, 64};
    bench_write(&bench, "a.tga", file, sizeof file);
    run_material(&bench, "map_d a.tga\n");
    bench_expect_ok(&bench);
    const blob_texture_t *opacity = &bench.blob.textures[bench.blob.shapes[0].alpha.texture - 1];
    const blob_image_t *alpha = &bench.blob.images[opacity->image - 1];
    assert_int_equal(opacity->channel, CHANNEL_R);
    assert_memory_equal(bench.blob.texels + alpha->first_word, ((uint8_t[]){255, 64}), 2);
    bench_close(&bench);
}

/* A TGA of 4 x 4 pixels whose colours are given as red, green and blue, in turn. */
static void write_colours(bench_t *bench, const char *name, const uint8_t (*colours)[3], size_t count)
{
    uint8_t file[18 + 3 * 16] = {[2] = 2, [12] = 4, [14] = 4, [16] = 24};
    for (size_t i = 0; i < 16; ++i)
        for (size_t k = 0; k < 3; ++k) file[18 + 3 * i + k] = colours[i % count][2 - k];
    bench_write(bench, name, file, sizeof file);
}

/* Blender writes its normal maps as bump maps. */
static void a_bump_map_of_normals_is_a_normal_map(void **state)
{
    (void)state;
    static const struct {
        const char *statement;
        uint8_t colours[3][3];
        bool normals;
    } cases[] = {
        {"map_Bump -bm 0.5 n.tga\n", {{128, 128, 255}, {179, 128, 245}, {77, 128, 245}}, true},
        {"map_Bump -imfchan r -bm 0.5 n.tga\n", {{128, 128, 255}, {179, 128, 245}, {77, 128, 245}}, false},
        {"map_Bump -bm 0.5 n.tga\n", {{128, 128, 128}, {128, 128, 128}, {255, 255, 255}}, false},
        {"map_Bump -bm 0.5 n.tga\n", {{200, 200, 200}, {201, 201, 201}, {202, 202, 202}}, false},
        {"map_Bump -bm 0.5 n.tga\n", {{255, 128, 128}, {245, 128, 179}, {245, 128, 77}}, false},
        {"map_Bump -bm 0.5 n.tga\n", {{255, 0, 255}, {0, 255, 255}, {128, 128, 255}}, false}, /* too long */
    };
    bench_t bench = {0};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        write_colours(&bench, "n.tga", cases[i].colours, 3);
        run_material(&bench, cases[i].statement);
        bench_expect_ok(&bench);
        const blob_material_t *material = material_of(&bench, 0);
        assert_int_equal(material->normal_map != 0, cases[i].normals);
        assert_int_equal(material->bump != 0, !cases[i].normals);
        assert_int_equal(strstr(bench.warnings, "a.mtl:2: this bump map holds normals") != NULL,
                         cases[i].normals);
        if (cases[i].normals) expect_near((double)material->normal_scale, 0.5, 0);
    }
    bench_close(&bench);
}

static void a_missing_image_is_an_error_unless_lenient(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_material(&bench, "map_Kd no.png\n");
    expect_text(bench.result.message, "a.mtl:2: the image no.png is missing");
    bench.lenient = true;
    run_material(&bench, "Kd .5 .5 .5\nmap_Kd no.png\n");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "no.png is missing");
    bench_close(&bench);
}

static void libraries_that_are_missing_or_wrong_are_named(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, "mtllib no.mtl\n" SQUARE "usemtl x\nf 1 2 3\n", NULL);
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "library of materials no.mtl is missing");
    expect_text(bench.warnings, "no library has the material \"x\"");
    run(&bench, "mtllib a.mtl\n" SQUARE "f 1 2 3\n", "Kd 1 1 1\n");
    expect_text(bench.result.message, "a.mtl:1: expected newmtl");
    run_material(&bench, "Kd x\n");
    expect_text(bench.result.message, "a.mtl:2: expected red, green and blue");
    run_material(&bench, "Ns\n");
    expect_text(bench.result.message, "expected a number");
    run_material(&bench, "Kd spectral a.rfl\n");
    expect_text(bench.result.message, "colours must be red, green and blue");
    bench_close(&bench);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(faces_share_vertices_that_have_the_same_indices),
        cmocka_unit_test(corners_with_two_normals_are_two_vertices),
        cmocka_unit_test(negative_indices_count_back_from_the_line),
        cmocka_unit_test(a_concave_face_is_cut_by_its_ears),
        cmocka_unit_test(faces_of_thousands_of_corners_are_cut_by_their_ears),
        cmocka_unit_test(a_face_may_have_a_hole_at_the_end_of_a_bridge),
        cmocka_unit_test(faces_that_cannot_be_cut_are_told),
        cmocka_unit_test(parts_are_by_name_material_and_normals),
        cmocka_unit_test(lines_may_be_joined_and_commented),
        cmocka_unit_test(a_byte_order_mark_is_no_part_of_a_line),
        cmocka_unit_test(what_a_file_lacks_is_done_without),
        cmocka_unit_test(what_is_wrong_is_named),
        cmocka_unit_test(a_file_without_light_gets_a_sky_and_a_camera_and_is_told),
        cmocka_unit_test(phong_becomes_what_reflects_as_much),
        cmocka_unit_test(opacity_is_d_or_the_rest_of_tr),
        cmocka_unit_test(maps_lie_on_the_surface_as_their_options_say),
        cmocka_unit_test(an_image_without_texture_coordinates_is_one_texel),
        cmocka_unit_test(opacity_is_the_alpha_of_grey_images_as_well),
        cmocka_unit_test(a_bump_map_of_normals_is_a_normal_map),
        cmocka_unit_test(a_missing_image_is_an_error_unless_lenient),
        cmocka_unit_test(libraries_that_are_missing_or_wrong_are_named),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
