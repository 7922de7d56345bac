/* What the importers make of materials that scatter light below their surface: media of their own, inside the
 * shapes that have them; and what a medium must be like to have a colour. */
#include "tests/unit/client/import/test_import.h"

#include "client/import/scene/half_space.h"
#include "common/sampler.h"

#define SKY "LightSource \"infinite\"\n"
#define SPHERE "Shape \"sphere\"\n"
#define FOG "MakeNamedMedium \"fog\" \"string type\" \"homogeneous\"\n"
#define CORNERS "\"point P\" [0 0 0 1 0 0 0 1 0 0 0 1]\n"
#define TETRAHEDRON "Shape \"trianglemesh\" \"integer indices\" [0 2 1 0 1 3 0 3 2 1 2 3] " CORNERS

static void run(bench_t *bench, bool v4, const char *world)
{
    char *text =
        mem_printf(v4 ? "Film \"rgb\"\nWorldBegin\n" SKY "%s\n" : "WorldBegin\n" SKY "%s\nWorldEnd\n", world);
    bench_run(bench, text);
    bench_expect_ok(bench);
    free(text);
}

static void run_quietly(bench_t *bench, bool v4, const char *world)
{
    run(bench, v4, world);
    bench_expect_silence(bench);
}

static const blob_medium_t *medium(const bench_t *bench, uint64_t index)
{
    assert_true(index < count_of(bench, BLOB_SECTION_MEDIA));
    return &bench->blob.media[index];
}

static const blob_shape_t *shape(const bench_t *bench, uint64_t index)
{
    assert_true(index < count_of(bench, BLOB_SECTION_SHAPES));
    return &bench->blob.shapes[index];
}

static void expect_media(const blob_shape_t *s, blob_ref_t inside, blob_ref_t outside)
{
    assert_int_equal(s->media[0], inside);
    assert_int_equal(s->media[1], outside);
    assert_int_equal((s->flags & SHAPE_INTERFACE) != 0, inside != outside);
}

/* That of the colour, in the media of the bench: to a relative 1e-4. */
static void expect_colour(const blob_medium_t *m, double r, double g, double b, double path, double eta)
{
    const double colour[3] = {r, g, b};
    for (int i = 0; i < 3; ++i) {
        double albedo = half_space_albedo(colour[i], (double)m->g, eta);
        expect_near((double)v_at(m->scattering, i) * path, albedo, 1e-4);
        expect_near((double)v_at(m->absorption, i) * path, 1 - albedo, 1e-4);
    }
}

/* ---- pbrt ---------------------------------------------------------------------------------------------- */

static void coefficients_are_taken_as_they_are(void **state)
{
    (void)state;
    for (int v4 = 0; v4 < 2; ++v4) {
        bench_t bench = {0};
        run_quietly(
            &bench, v4,
            "Material \"subsurface\" \"rgb sigma_a\" [1 2 3] \"rgb sigma_s\" [4 5 6] \"float scale\" 2 "
            "\"float g\" -.5 \"float eta\" 1.5 \"float uroughness\" .2\n" SPHERE
            "Material \"subsurface\" \"string name\" \"Ketchup\" \"float scale\" 10\n" SPHERE
            "Material \"subsurface\"\n" SPHERE);
        assert_int_equal(count_of(&bench, BLOB_SECTION_MEDIA), 3);
        expect_vec3(medium(&bench, 0)->absorption, 2, 4, 6);
        expect_vec3(medium(&bench, 0)->scattering, 8, 10, 12);
        expect_near((double)medium(&bench, 0)->g, -0.5, 0);
        expect_vec3(medium(&bench, 1)->absorption, 0.61, 9.7, 14.5);
        expect_vec3(medium(&bench, 1)->scattering, 1.8, 0.7, 0.3);
        expect_vec3(medium(&bench, 2)->absorption, 0.0011, 0.0024, 0.014);
        expect_vec3(medium(&bench, 2)->scattering, 2.55, 3.21, 3.77);
        for (uint32_t i = 0; i < 3; ++i) {
            const blob_material_t *m = &bench.blob.materials[shape(&bench, i)->material];
            assert_int_equal(m->kind, MATERIAL_DIELECTRIC);
            assert_int_equal(m->body, i + 1);
            expect_near((double)m->values[VALUE_ETA].factor.x, i == 0 ? 1.5 : 1.33, 1e-6);
            expect_vec3(m->values[VALUE_TRANSMITTANCE].factor, 1, 1, 1);
            expect_media(shape(&bench, i), i + 1, 0);
        }
        bench_close(&bench);
    }
}

static void a_colour_becomes_a_medium_that_has_it(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_quietly(
        &bench, false,
        "Material \"kdsubsurface\" \"rgb Kd\" [.2 .5 1] \"rgb mfp\" [2 2 2] \"float scale\" .5 \"float "
        "eta\" 1.4 \"float g\" .4\n" SPHERE);
    expect_colour(medium(&bench, 0), 0.2, 0.5, 1, 1, 1.4);
    expect_near((double)medium(&bench, 0)->absorption.z, 0, 0);
    run_quietly(&bench, true,
                "Material \"subsurface\" \"rgb reflectance\" [.2 .5 .8] \"rgb mfp\" [4 4 4] \"float eta\" "
                "1.5\n" SPHERE);
    expect_colour(medium(&bench, 0), 0.2, 0.5, 0.8, 4, 1.5);
    /* s = 1.9 - 0.3 + 3.5 (0.3 - 0.8)^2 = 2.475 */
    run_quietly(&bench, false,
                "Material \"disney\" \"rgb color\" [.3 .3 .3] \"rgb scatterdistance\" [2 2 2]\n" SPHERE);
    expect_colour(medium(&bench, 0), 0.3, 0.3, 0.3, 0.2 * 2.475 * 2, 1.5);
    assert_int_equal(bench.blob.materials[0].kind, MATERIAL_DISNEY);
    assert_true(bench.blob.materials[0].flags & MATERIAL_TINTED_BODY);
    run_quietly(&bench, false,
                "Material \"disney\" \"rgb scatterdistance\" [2 2 2] \"bool thin\" \"true\"\n" SPHERE);
    assert_int_equal(count_of(&bench, BLOB_SECTION_MEDIA), 0);
    bench_close(&bench);
}

/* A colour keeps its pattern, other things become even. */
static void what_varies_becomes_even_or_a_tint(void **state)
{
    (void)state;
#define CHECKS(name, a, b)                                                                                   \
    "Texture \"" name "\" \"spectrum\" \"checkerboard\" \"rgb tex1\" [" a "] \"rgb tex2\" [" b "]\n"
    bench_t bench = {0};
    run_quietly(
        &bench, false,
        CHECKS("k", ".2 .5 .4", ".8 .1 .4") "Material \"kdsubsurface\" \"texture Kd\" \"k\"\n" SPHERE);
    expect_colour(medium(&bench, 0), 0.8, 0.5, 0.4, 1, 1.33);
    const blob_material_t *m = &bench.blob.materials[0];
    assert_true(m->flags & MATERIAL_TINTED_BODY);
    expect_vec3(m->values[VALUE_ALBEDO].factor, 1.25, 2, 2.5);
    assert_int_not_equal(m->values[VALUE_ALBEDO].texture, 0);
    run(&bench, false,
        CHECKS("s", "1 2 3",
               "3 4 7") "Material \"subsurface\" \"texture sigma_s\" \"s\" \"rgb sigma_a\" [1 1 "
                        "1]\n" SPHERE);
    expect_vec3(medium(&bench, 0)->scattering, 2, 3, 5);
    assert_int_equal(bench.warning_count, 1);
    expect_text(bench.warnings, "s.pbrt:4:23: \"sigma_s\" varies, but what is below a surface is the same "
                                "everywhere: its mean is taken, 2 3 5");
    static const char image[] = "PF\n1 1\n-1\n\0\0\x80\x3f\0\0\x80\x3f\0\0\x80\x3f"; /* ones */
    bench_write(&bench, "t.pfm", image, sizeof image - 1);
    run(&bench, false,
        "Texture \"t\" \"spectrum\" \"imagemap\" \"string filename\" \"t.pfm\" \"float scale\" -1\n"
        "Material \"subsurface\" \"texture sigma_s\" \"t\"\n" SPHERE);
    expect_vec3(medium(&bench, 0)->scattering, 0, 0, 0); /* not negative */
    bench_close(&bench);
}

/* Not even where a shape has made it once more, for a parameter that nothing knows. */
static void other_materials_have_no_body(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, false,
        "MakeNamedMaterial \"n\" \"string type\" \"none\"\nNamedMaterial \"n\"\n" SPHERE
        "Material \"subsurface\"\nShape \"sphere\" \"float foo\" 1\n"
        "NamedMaterial \"n\"\nAreaLightSource \"diffuse\"\n" SPHERE);
    assert_int_equal(count_of(&bench, BLOB_SECTION_MEDIA), 1);
    assert_int_equal(bench.blob.materials[shape(&bench, 0)->material].body, 1);
    assert_int_equal(bench.blob.materials[shape(&bench, 1)->material].body, 0);
    bench_close(&bench);
}

/* Outside is what the interface in force has there, inside is the body, whatever it says; also of an object's
 * shapes, and of a material that comes later. */
static void bodies_lie_inside_their_shapes(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_quietly(&bench, true,
                FOG "MediumInterface \"fog\"\nMakeNamedMaterial \"wax\" \"string type\" \"subsurface\"\n"
                    "NamedMaterial \"wax\"\n" SPHERE "MediumInterface \"fog\" \"\"\n" SPHERE
                    "NamedMaterial \"later\"\nMediumInterface \"fog\"\n" SPHERE
                    "MakeNamedMaterial \"later\" \"string type\" \"subsurface\"\n"
                    "Material \"diffuse\"\n" SPHERE "NamedMaterial \"wax\"\nAttributeBegin\nAreaLightSource "
                    "\"diffuse\"\n" SPHERE "AttributeEnd\nObjectBegin \"o\"\n" TETRAHEDRON
                    "ObjectEnd\nObjectInstance \"o\"\n");
    expect_media(shape(&bench, 0), 2, 1);
    expect_media(shape(&bench, 1), 2, 0);
    expect_media(shape(&bench, 2), 3, 1);
    expect_media(shape(&bench, 3), 0, 0);
    expect_media(shape(&bench, 4), 2, 1);
    expect_media(shape(&bench, 5), 2, 1);
    assert_int_equal(bench.blob.lights[shape(&bench, 4)->light].medium, 0);
    bench_close(&bench);
}

/* A quadric that emits and is mirrored has its normal turned the other way than pbrt. */
static void bodies_keep_to_pbrts_side(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, false, "Material \"kdsubsurface\"\nAreaLightSource \"diffuse\"\nScale -1 1 1\n" SPHERE);
    assert_int_equal(shape(&bench, 0)->media[1], 1);
    assert_int_equal(shape(&bench, 0)->media[0], 0);
    bench_close(&bench);
}

static void a_mix_has_the_body_of_its_part(void **state)
{
    (void)state;
    bench_t bench = {0};
#define NAMED(name, rest) "MakeNamedMaterial \"" name "\" \"string type\" " rest "\n"
#define MIX(a, b) "Material \"mix\" \"string namedmaterial1\" \"" a "\" \"string namedmaterial2\" \"" b "\"\n"
#define PARTS NAMED("wax", "\"kdsubsurface\"") NAMED("matte", "\"matte\"") NAMED("milk", "\"subsurface\"")
    run_quietly(&bench, false, PARTS MIX("wax", "matte") SPHERE);
    expect_media(shape(&bench, 0), 1, 0);
    bench.lenient = true;
    run(&bench, false, PARTS MIX("wax", "milk") SPHERE);
    expect_text(bench.warnings, "both parts of this mix scatter light below the surface");
    bench_close(&bench);
}

static void open_bodies_are_told_of(void **state)
{
    (void)state;
#define WAX "Material \"kdsubsurface\"\n"
    bench_t bench = {0};
    run_quietly(&bench, false, WAX TETRAHEDRON SPHERE "Scale -1 1 1\n" TETRAHEDRON);
    run_quietly(&bench, false, /* of two shapes */
                WAX "Shape \"trianglemesh\" \"integer indices\" [0 2 1 0 1 3] " CORNERS
                    "Shape \"trianglemesh\" \"integer indices\" [0 3 2 1 2 3] " CORNERS);
    static const struct {
        const char *text, *message;
    } cases[] = {
        {"Shape \"trianglemesh\" \"integer indices\" [0 2 1 0 1 3 0 3 2] " CORNERS, "is not closed, or its"},
        {"Shape \"trianglemesh\" \"integer indices\" [0 2 1 0 1 3 0 3 2 1 3 2] " CORNERS,
         "is not closed, or its"},
        {"ReverseOrientation\n" TETRAHEDRON, "is turned inside out"},
        {"ReverseOrientation\n" SPHERE, "is turned inside out"}};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        char *text = mem_printf(WAX "%s", cases[i].text);
        run(&bench, false, text);
        assert_int_equal(bench.warning_count, 1);
        expect_text(bench.warnings, cases[i].message);
        expect_text(bench.warnings, "the surface of \"s.pbrt:");
        free(text);
    }
    bench_close(&bench);
}

/* ---- glTF ---------------------------------------------------------------------------------------------- */

static void run_gltf(bench_t *bench, const char *extensions)
{
    char *text = mem_printf(
        "{\"asset\":{\"version\":\"2.0\"},\"scene\":0,\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{\"mesh\":0}],"
        "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":1,\"material\":0}]}],"
        "\"materials\":[{\"extensions\":{%s}}],"
        "\"buffers\":[{\"byteLength\":60,\"uri\":\"data:application/octet-stream;base64,"
        "AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAAAAAAAAAAAAAAAIA/AAIBAAEDAAMCAQID\"}],"
        "\"bufferViews\":[{\"buffer\":0,\"byteLength\":48},{\"buffer\":0,\"byteOffset\":48,\"byteLength\":12}"
        "],"
        "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\",\"min\":[0,0,"
        "0],"
        "\"max\":[1,1,1]},{\"bufferView\":1,\"componentType\":5121,\"count\":12,\"type\":\"SCALAR\"}]}",
        extensions);
    bench_write(bench, "s.gltf", text, strlen(text));
    bench_import_file(bench, "s.gltf");
    bench_expect_ok(bench);
    free(text);
}

/* The standard's formula of 0.5 is 0.951; of 0 it is 0. */
static void gltf_volumes_scatter(void **state)
{
    (void)state;
#define VOLUME(more)                                                                                         \
    "\"KHR_materials_volume\":{\"attenuationColor\":[0.5,0.25,1],\"attenuationDistance\":2" more "}"
#define SCATTER(colour, more)                                                                                \
    ",\"KHR_materials_transmission\":{\"transmissionFactor\":1},\"KHR_materials_volume_scatter\":{"          \
    "\"multiscatterColor\":[" colour "]" more "}"
    bench_t bench = {0};
    run_gltf(&bench, VOLUME("") SCATTER("0.5,0,0.5", ",\"scatterAnisotropy\":0.5"));
    const double s = 4.09712 + 4.20863 * 0.5 - sqrt(9.59217 + 41.6808 * 0.5 + 17.7126 * 0.25);
    double share = (1 - s * s) / (1 - 0.5 * s * s), loss = log(2) / 2;
    expect_vec3(medium(&bench, 0)->scattering, share * loss, 0, 0);
    expect_vec3(medium(&bench, 0)->absorption, (1 - share) * loss, 2 * loss, 0);
    expect_near((double)medium(&bench, 0)->g, 0.5, 1e-6);
    assert_int_equal(bench.blob.materials[0].body, 1);
    expect_vec3(bench.blob.materials[0].values[VALUE_ATTENUATION].factor, 0, 0, 0);
    expect_media(shape(&bench, 0), 1, 0);
    assert_null(strstr(bench.warnings, "surface"));
    run_gltf(&bench, VOLUME(",\"thicknessFactor\":0") SCATTER("0.5,0,0.5", ""));
    assert_int_equal(count_of(&bench, BLOB_SECTION_MEDIA), 0);
    assert_true(bench.blob.materials[0].flags & MATERIAL_THIN);
    expect_text(bench.warnings, "scatters nothing without KHR_materials_volume and a thickness");
    run_gltf(&bench, VOLUME(",\"thicknessFactor\":1") SCATTER("0,0,0", ""));
    assert_int_equal(count_of(&bench, BLOB_SECTION_MEDIA), 0);
    expect_vec3(bench.blob.materials[0].values[VALUE_ATTENUATION].factor, loss, 2 * loss, 0);
    bench_close(&bench);
}

/* ---- the colour of a half space ------------------------------------------------------------------------ */

/* Fresnel's reflectance from within. */
static double reflected(double inside, double eta)
{
    double sine2 = (1 - inside * inside) * eta * eta;
    if (sine2 >= 1) return 1;
    double outside = sqrt(1 - sine2), a = (outside - eta * inside) / (outside + eta * inside);
    double b = (eta * outside - inside) / (eta * outside + inside);
    return (a * a + b * b) / 2;
}

/* What comes out of light that has entered in a direction of this cosine, downwards. */
static double follow(sampler_t *numbers, double albedo, double g, double eta, double cosine)
{
    double depth = 0, weight = 1, left = 0;
    while (weight > 1e-3) {
        depth -= cosine * log(1 - (double)sampler_1d(numbers));
        if (depth < 0) {
            double back = reflected(-cosine, eta);
            left += weight * (1 - back);
            weight *= back;
            cosine = -cosine;
            depth = 0;
            continue;
        }
        weight *= albedo;
        double u = (double)sampler_1d(numbers), t = (1 - g * g) / (1 - g + 2 * g * u);
        double turn = fabs(g) < 1e-3 ? 1 - 2 * u : (1 + g * g - t * t) / (2 * g);
        double around = cos(2 * M_PI * (double)sampler_1d(numbers));
        cosine = cosine * turn + sqrt(fmax(0, (1 - cosine * cosine) * (1 - turn * turn))) * around;
    }
    return left;
}

static void media_have_the_colour_that_is_wanted(void **state)
{
    (void)state;
    enum { COUNT = 8000 };
    static const struct {
        double albedo, g, eta;
    } cases[] = {{0.5, 0, 1},    {0.9, 0, 1.33},   {0.97, 0.7, 1.5},
                 {0.9, 0.95, 1}, {0.8, -0.4, 1.5}, {0.9, 0, 0.8}};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        double albedo = cases[i].albedo, g = cases[i].g, eta = cases[i].eta, sum = 0, squares = 0,
               entered = 0;
        for (uint32_t k = 0; k < COUNT; ++k) {
            sampler_t numbers = sampler_new(SAMPLER_INDEPENDENT, 7, (uint32_t)i, k);
            double outside = sqrt((double)sampler_1d(&numbers));
            double inside = sqrt(fmax(0, 1 - (1 - outside * outside) / (eta * eta)));
            double in = 1 - reflected(inside, eta);
            double out = in > 0 ? in * follow(&numbers, albedo, g, eta, inside) : 0;
            entered += in, sum += out, squares += out * out;
        }
        double share = half_space_reflectance(albedo, g, eta);
        double error = sqrt(squares - sum * sum / COUNT) / entered;
        print_message("albedo %.2f, g %.2f, index %.2f: %.4f, by chance %.4f +- %.4f\n", albedo, g, eta,
                      share, sum / entered, error);
        expect_near(share, sum / entered, 0.0015 + 3 * error);
        expect_near(half_space_albedo(share, g, eta), albedo, 1e-4);
    }
    assert_true(half_space_albedo(0, 0, 1.5) == 0 && half_space_albedo(-1, 0, 1.5) == 0);
    assert_true(half_space_albedo(1, 0, 1.5) == 1 && half_space_albedo(2, 0, 1.5) == 1);
    expect_near(half_space_reflectance(1, 0.5, 1.5), 1, 1e-9);
    for (double r = 0.01; r < 1; r += 0.07)
        expect_near(half_space_reflectance(half_space_albedo(r, 0.3, 1.4), 0.3, 1.4), r, 1e-5);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(coefficients_are_taken_as_they_are),
        cmocka_unit_test(a_colour_becomes_a_medium_that_has_it),
        cmocka_unit_test(what_varies_becomes_even_or_a_tint),
        cmocka_unit_test(other_materials_have_no_body),
        cmocka_unit_test(bodies_lie_inside_their_shapes),
        cmocka_unit_test(bodies_keep_to_pbrts_side),
        cmocka_unit_test(a_mix_has_the_body_of_its_part),
        cmocka_unit_test(open_bodies_are_told_of),
        cmocka_unit_test(gltf_volumes_scatter),
        cmocka_unit_test(media_have_the_colour_that_is_wanted),
    };
    return cmocka_run_group_tests_name("import_subsurface", tests, NULL, NULL);
}
