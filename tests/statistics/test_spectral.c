/* Spectral jobs: colours and the spectra that stand for them, measured spectra as the importer keeps them,
 * dispersion by Snell's law, and renders against those in red, green and blue. */
#include "tests/reference.h"
#include "tests/render_here.h"
#include "tests/unit/client/import/test_import.h"
#include "worker/render/bsdf/film.h"
#include "worker/render/material/material.h"
#include "worker/render/spectral/response.h"
#include "worker/render/spectral/waves.h"

static waves_tables_t *tables;

static double worst_of(rgb_t a, rgb_t b)
{
    return fmax(fabs((double)(a.x - b.x)), fmax(fabs((double)(a.y - b.y)), fabs((double)(a.z - b.z))));
}

/* ---- colours ------------------------------------------------------------------------------------------- */

/* What the film shows of it under D65, by the observer's own sum. */
static rgb_t colour_of(const response_t *response, const upsampled_t *s)
{
    double rgb[3] = {0};
    for (int i = 0; i < CIE_COUNT; i++)
        for (int c = 0; c < 3; c++)
            rgb[c] += response->white[c][i] * (double)upsampled_at(s, 2 * (float)i / (CIE_COUNT - 1) - 1);
    return vec3((float)rgb[0], (float)rgb[1], (float)rgb[2]);
}

static void every_colour_comes_back(void **state)
{
    (void)state;
    enum { SIDE = 20 };
    upsampling_t *table = upsampling_new();
    response_t response;
    response_init(&response);
    double worst = 0, brightest = 0;
    for (int i = 0; i < SIDE * SIDE * SIDE; i++) {
        rgb_t colour = v_scale(vec3((float)(i % SIDE), (float)(i / SIDE % SIDE), (float)(i / SIDE / SIDE)),
                               1.0f / (SIDE - 1));
        upsampled_t s = upsample_reflectance(table, colour);
        worst = fmax(worst, worst_of(colour_of(&response, &s), colour));
        for (int k = -10; k <= 10; k++)
            brightest = fmax(brightest, (double)upsampled_at(&s, 0.1f * (float)k));
        upsampled_t light = upsample_unbounded(table, v_scale(colour, 40));
        worst = fmax(worst, worst_of(v_scale(colour_of(&response, &light), 1.0f / 40), colour));
    }
    print_message("colours come back within %.4f\n", worst);
    assert_true(worst < 0.005);
    assert_true(brightest <= 1);
    /* Greys are flat, and black is black. */
    for (float grey = 0; grey <= 1; grey += 0.125f) {
        upsampled_t s = upsample_reflectance(table, vec3(grey, grey, grey));
        assert_true(upsampled_at(&s, -0.7f) == grey && upsampled_at(&s, 0.4f) == grey);
    }
    upsampling_destroy(&table);
}

enum { DRAWS = 4096 };

/* The mean over the wavelengths that are drawn of what the film shows of some light. */
static rgb_t mean_colour(rgb_t (*light)(const waves_t *waves, const void *of), const void *of)
{
    double sum[3] = {0};
    for (int i = 0; i < DRAWS; i++) {
        waves_t waves = waves_draw(tables, ((float)i + 0.5f) / DRAWS);
        rgb_t c = waves_colour(&waves, light(&waves, of));
        sum[0] += (double)c.x / DRAWS, sum[1] += (double)c.y / DRAWS, sum[2] += (double)c.z / DRAWS;
    }
    return vec3((float)sum[0], (float)sum[1], (float)sum[2]);
}

static rgb_t light_of_colour(const waves_t *waves, const void *colour)
{
    return waves_light(waves, *(const rgb_t *)colour);
}

static void drawn_wavelengths_show_the_colour(void **state)
{
    (void)state;
    static const rgb_t colours[] = {{1, 1, 1}, {5, 5, 5}, {0.9f, 0.3f, 0.1f}, {2, 3, 9}, {0, 0.4f, 0}};
    for (size_t i = 0; i < ARRAY_LENGTH(colours); i++) {
        rgb_t seen = mean_colour(light_of_colour, &colours[i]);
        double most = (double)v_max(colours[i]), grey = i < 2 ? 2e-4 : 0.004;
        if (!(worst_of(seen, colours[i]) < grey * most))
            fail_msg("%g %g %g shows as %g %g %g", (double)colours[i].x, (double)colours[i].y,
                     (double)colours[i].z, (double)seen.x, (double)seen.y, (double)seen.z);
    }
}

/* ---- measured spectra ---------------------------------------------------------------------------------- */

typedef struct {
    const scene_blob_t *blob;
    const blob_value_t *value;
} kept_t;

static rgb_t light_of_spectrum(const waves_t *waves, const void *of)
{
    const kept_t *kept = of;
    assert_true(kept->value->spectrum > 0);
    return v_scale(waves_spectrum(waves, &kept->blob->spectra[kept->value->spectrum - 1]),
                   v_max(kept->value->factor));
}

static void lights_shine_by_their_spectra(void **state)
{
    (void)state;
    static const char *const scenes[] = {
        "Film \"rgb\"\nWorldBegin\nLightSource \"point\" \"blackbody I\" [4500]\n",
        "Film \"rgb\"\nWorldBegin\nLightSource \"point\" \"blackbody I\" [2700] \"float scale\" [7]\n",
        "Film \"rgb\"\nWorldBegin\nLightSource \"infinite\" \"spectrum L\" \"stdillum-F11\"\n",
        "Film \"rgb\"\nWorldBegin\nLightSource \"distant\" \"spectrum L\" \"stdillum-D65\"\n",
        "Film \"rgb\"\nWorldBegin\nLightSource \"point\" \"spectrum I\" [545 0 546 90 547 0 360 0.1 830 "
        "0.1]\n",
        "WorldBegin\nLightSource \"point\" \"blackbody I\" [6500 3]\nWorldEnd\n",
        "WorldBegin\nLightSource \"point\" \"spectrum I\" [300 2 900 4] \"rgb scale\" [2 2 2]\nWorldEnd\n",
    };
    bench_t bench = {0};
    for (size_t i = 0; i < ARRAY_LENGTH(scenes); i++) {
        bench_run(&bench, scenes[i]);
        assert_int_equal(bench.result.code, RESULT_OK);
        kept_t kept = {&bench.blob, &bench.blob.lights[0].radiance};
        rgb_t seen = v_high(mean_colour(light_of_spectrum, &kept), vec3(0, 0, 0)), /* RGB is clipped, too */
            rgb = kept.value->factor;
        if (!(worst_of(seen, rgb) < 0.01 * (double)v_max(rgb)))
            fail_msg("scene %zu: %g %g %g, in RGB %g %g %g", i, (double)seen.x, (double)seen.y,
                     (double)seen.z, (double)rgb.x, (double)rgb.y, (double)rgb.z);
    }
    /* A scale with a colour makes another light of it. */
    bench_run(&bench,
              "WorldBegin\nLightSource \"point\" \"blackbody I\" [6500 3] \"rgb scale\" [1 2 1]\nWorldEnd\n");
    assert_int_equal(bench.blob.lights[0].radiance.spectrum, 0);
    bench_close(&bench);
}

/* ---- surfaces ------------------------------------------------------------------------------------------ */

/* A sheet that faces -z, at the origin. */
static scene_t *load_sheet(bench_t *bench, const char *material, surface_t *surface)
{
    char *text = mem_printf("Film \"rgb\"\nWorldBegin\nLightSource \"infinite\"\n%s\nShape \"trianglemesh\" "
                            "\"integer indices\" [0 2 1] \"point3 P\" [-1 -1 0  2 -1 0  -1 2 0]\n",
                            material);
    scene_t *scene;
    bench_run(bench, text);
    free(text);
    if (bench->result.code != RESULT_OK) fail_msg("%s", bench->result.message);
    assert_int_equal(scene_new(&bench->blob, &scene).code, RESULT_OK);
    assert_true(scene_intersect(scene, vec3(0, 0, -1), vec3(0, 0, 1), 0, surface));
    return scene;
}

typedef struct {
    const scene_t *scene;
    const surface_t *surface;
} sheet_t;

/* What it mirrors of white light at 45 degrees. */
static rgb_t mirrored(const waves_t *waves, const void *of)
{
    const sheet_t *sheet = of;
    bsdf_t bsdf;
    bsdf_sample_t sample;
    material_bsdf_of(sheet->scene, sheet->surface, waves, &bsdf);
    assert_true(bsdf_sample(&bsdf, vec3(0.70710678f, 0, -0.70710678f), (vec2_t){0.5f, 0.5f}, 0,
                            TRANSPORT_RADIANCE, &sample));
    return waves == NULL ? sample.weight : v_mul(sample.weight, waves->white);
}

static void metals_have_their_colours(void **state)
{
    (void)state;
    static const struct {
        const char *material;
        double off; /* from RGB, where eta and k of the channels are means */
    } cases[] = {
        {"Material \"conductor\" \"spectrum eta\" \"metal-Au-eta\" \"spectrum k\" \"metal-Au-k\"", 0.05},
        {"Material \"conductor\" \"spectrum eta\" \"metal-Cu-eta\" \"spectrum k\" \"metal-Cu-k\"", 0.05},
        {"Material \"conductor\" \"spectrum eta\" \"metal-Ag-eta\" \"spectrum k\" \"metal-Ag-k\"", 0.01},
        {"Material \"conductor\" \"rgb reflectance\" [0.8 0.4 0.2]", 0.01},
        {"Material \"conductor\" \"rgb reflectance\" [0.5 0.5 0.5]", 1e-3},
        {"Material \"conductor\" \"rgb eta\" [0.2 0.9 1.2] \"rgb k\" [3.9 2.5 2.2]", 0.05},
    };
    bench_t bench = {0};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++) {
        surface_t surface;
        scene_t *scene = load_sheet(&bench, cases[i].material, &surface);
        sheet_t sheet = {scene, &surface};
        rgb_t seen = mean_colour(mirrored, &sheet), rgb = mirrored(NULL, &sheet);
        print_message("metal %zu: %.3f %.3f %.3f, in RGB %.3f %.3f %.3f\n", i, (double)seen.x, (double)seen.y,
                      (double)seen.z, (double)rgb.x, (double)rgb.y, (double)rgb.z);
        assert_true(worst_of(seen, rgb) < cases[i].off);
        scene_destroy(&scene);
    }
    bench_close(&bench);
}

/* Of BK7, by Sellmeier's formula. */
static double bk7(double nm)
{
    double l2 = nm * nm * 1e-6;
    return sqrt(1 + 1.03961212 * l2 / (l2 - 0.00600069867) + 0.231792344 * l2 / (l2 - 0.0200179144) +
                1.01046945 * l2 / (l2 - 103.560653));
}

/* Each wavelength goes its own way, by Snell's law, and what is drawn adds up to what Fresnel's equations
 * leave, over the squared index. */
static void glass_refracts_each_wavelength(void **state)
{
    (void)state;
    enum { TIMES = 300 };
    bench_t bench = {0};
    surface_t surface;
    scene_t *scene = load_sheet(&bench, "Material \"dielectric\" \"spectrum eta\" \"glass-BK7\"", &surface);
    const float sine = 0.8f;
    vec3_t wo = vec3(sine, 0, -0.6f);
    int met[3] = {0};
    for (int i = 0; i < 40; i++) {
        waves_t waves = waves_draw(tables, ((float)i + 0.5f) / 40);
        bsdf_t bsdf;
        double sums[3] = {0};
        material_bsdf_of(scene, &surface, &waves, &bsdf);
        for (int k = 0; k < TIMES; k++) {
            bsdf_sample_t sample;
            assert_true(bsdf_sample(&bsdf, wo, (vec2_t){0.5f, 0.5f}, ((float)k + 0.5f) / TIMES,
                                    TRANSPORT_RADIANCE, &sample));
            if (sample.wi.z < 0) continue;
            const float weight[3] = {sample.weight.x, sample.weight.y, sample.weight.z};
            int channel = weight[0] > 0 ? 0 : weight[1] > 0 ? 1 : 2;
            double eta = bk7((double)waves.nm[channel]);
            assert_true(weight[(channel + 1) % 3] == 0 && weight[(channel + 2) % 3] == 0);
            assert_true(fabs((double)(-sample.wi.x) - (double)sine / eta) < 2e-5);
            sums[channel] += (double)weight[channel] / TIMES;
            met[channel]++;
        }
        for (int c = 0; c < 3; c++) {
            double eta = bk7((double)waves.nm[c]);
            float cosine;
            double passed = 1 - (double)fresnel_dielectric(0.6f, (float)eta, &cosine);
            assert_true(fabs(sums[c] - passed / (eta * eta)) < 0.02);
        }
    }
    assert_true(met[0] > 0 && met[1] > 0 && met[2] > 0);
    /* What carries one wavelength keeps it, without a choice. */
    waves_t waves = waves_draw(tables, 0.3f);
    bsdf_t bsdf;
    bsdf_sample_t sample;
    material_bsdf_of(scene, &surface, &waves, &bsdf);
    bsdf_carry(&bsdf, vec3(0, 1, 0));
    assert_true(bsdf_sample(&bsdf, wo, (vec2_t){0.5f, 0.5f}, 0.9f, TRANSPORT_RADIANCE, &sample));
    assert_true(fabs((double)(-sample.wi.x) - (double)sine / bk7((double)waves.nm[1])) < 2e-5);
    /* In red, green and blue there is one way for all, by the index of the d line. */
    material_bsdf(scene, &surface, &bsdf);
    assert_true(bsdf_sample(&bsdf, wo, (vec2_t){0.5f, 0.5f}, 0.9f, TRANSPORT_RADIANCE, &sample));
    assert_true(fabs((double)(-sample.wi.x) - (double)sine / 1.5168) < 1e-6 &&
                sample.weight.x == sample.weight.z);
    scene_destroy(&scene);
    bench_close(&bench);
}

/* glTF's dispersion has the index and the Abbe number that it says. */
static void abbe_numbers_hold(void **state)
{
    (void)state;
    const float lines[3] = {486.13f, 587.56f, 656.27f}, ior = 1.6f, abbe = 30;
    waves_t waves = {.nm = {lines[0], lines[1], lines[2]}};
    shading_t shading = {.waves = &waves};
    float iors[3];
    shading_spread(&shading, ior, 20 / abbe, iors);
    assert_float_equal(iors[1], ior, 1e-6f);
    assert_float_equal((iors[1] - 1) / (iors[0] - iors[2]), abbe, 0.01f);
}

/* A film in the limit of none is the bare surface, and in between it is Airy's sum. */
static void films_interfere_by_wavelength(void **state)
{
    (void)state;
    const float f0 = 0.04f, eta = 1.3f, nm = 380, waves[3] = {430, 550, 660};
    lobe_film_t film = {.strength = 1, .ior = eta, .thickness = nm};
    for (int k = 0; k < 3; k++) film.waves[k] = (uint16_t)(waves[k] * FILM_PART);
    rgb_t found = film_reflectance(&film, vec3(f0, f0, f0), 1);
    const float r[3] = {found.x, found.y, found.z};
    for (int k = 0; k < 3; k++) {
        double base = (1 + sqrt(0.0401)) / (1 - sqrt(0.0401)), n = (double)eta;
        double upper = (1 - n) / (1 + n), lower = (n - base) / (n + base);
        double c = cos(4 * M_PI * n * (double)nm / (double)waves[k]), both = upper * lower;
        double truth = (upper * upper + lower * lower + 2 * both * c) / (1 + both * both + 2 * both * c);
        assert_true(fabs((double)r[k] - truth) < 1e-3);
    }
}

/* ---- renders ------------------------------------------------------------------------------------------- */

static estimate_image_t render(const scene_blob_t *blob, integrator_t integrator, uint32_t spp, bool spectral)
{
    job_settings_t settings = blob_default_settings(blob);
    settings.integrator = integrator;
    settings.spp = spp;
    settings.seed = spectral ? 5 : 6;
    settings.spectral = spectral;
    film_t *film = render_here(blob, &settings);
    assert_int_equal(film->counts.dropped, 0);
    estimate_image_t image = reference_estimate(film);
    film_destroy(&film);
    return image;
}

/* Every material that has shares of light, in fog, and a metal of one eta and k. */
static const char *const greys =
    "LookAt 0 1.2 -4  0 0.8 0  0 1 0\nMakeNamedMedium \"fog\" \"string type\" \"homogeneous\" \"rgb "
    "sigma_a\" [0.02 "
    "0.02 0.02] \"rgb sigma_s\" [0.05 0.05 0.05]\nMediumInterface \"\" \"fog\"\nCamera \"perspective\" "
    "\"float fov\" "
    "[45]\nFilm \"rgb\" \"integer xresolution\" [32] \"integer yresolution\" [32]\n"
    "PixelFilter \"box\" \"float xradius\" [0.5] \"float yradius\" [0.5]\nIntegrator \"bdpt\" \"integer "
    "maxdepth\" [4]\n"
    "WorldBegin\nMediumInterface \"fog\" \"fog\"\n"
    "AttributeBegin\nAreaLightSource \"diffuse\" \"rgb L\" [9 9 9]\nShape \"trianglemesh\" \"integer "
    "indices\" [0 1 2 0 "
    "2 3] \"point3 P\" [-0.8 3 -0.8  0.8 3 -0.8  0.8 3 0.8  -0.8 3 0.8]\nAttributeEnd\n"
    "Material \"diffuse\" \"rgb reflectance\" [0.6 0.6 0.6]\nShape \"trianglemesh\" \"integer indices\" [0 1 "
    "2 0 2 3] "
    "\"point3 P\" [-3 0 -3  -3 0 3  3 0 3  3 0 -3]\n"
    "Material \"coateddiffuse\" \"rgb reflectance\" [0.4 0.4 0.4] \"float roughness\" [0.3]\nAttributeBegin\n"
    "Translate -1.1 0.5 0\nShape \"sphere\" \"float radius\" [0.5]\nAttributeEnd\n"
    "Material \"conductor\" \"rgb eta\" [1.4 1.4 1.4] \"rgb k\" [4 4 4] \"float roughness\" "
    "[0.3]\nAttributeBegin\n"
    "Translate 0 0.5 0.4\nShape \"sphere\" \"float radius\" [0.5]\nAttributeEnd\n"
    "Material \"dielectric\" \"float eta\" [1.5] \"float roughness\" [0.4]\nAttributeBegin\n"
    "Translate 1.1 0.5 0\nShape \"sphere\" \"float radius\" [0.5]\nAttributeEnd\n";

static void greys_agree_with_rgb(void **state)
{
    (void)state;
    static const struct {
        integrator_t integrator;
        uint32_t spp;
    } ways[] = {{INTEGRATOR_BDPT, 128}, {INTEGRATOR_PATH, 192}, {INTEGRATOR_LIGHT, 256}};
    bench_t bench = {0};
    bench_run(&bench, greys);
    if (bench.result.code != RESULT_OK) fail_msg("%s", bench.result.message);
    for (size_t i = 0; i < ARRAY_LENGTH(ways); i++) {
        estimate_image_t rgb = render(&bench.blob, ways[i].integrator, ways[i].spp, false),
                         spectral = render(&bench.blob, ways[i].integrator, ways[i].spp, true);
        agreement_limits_t limits = agreement_default_limits();
        limits.max_rms = 1.4; /* of 16 blocks */
        agreement_t agreement;
        agreement_measure(&spectral, &rgb, &agreement);
        print_message("%s: ratio %.4f %.4f %.4f, z rms %.2f max %.2f\n", integrator_name(ways[i].integrator),
                      agreement.mean_ratio[0], agreement.mean_ratio[1], agreement.mean_ratio[2],
                      agreement.rms_z, agreement.max_z);
        bool holds = agreement_holds(&agreement, &limits);
        agreement_free(&agreement);
        estimate_image_free(&rgb);
        estimate_image_free(&spectral);
        assert_true(holds);
    }
    bench_close(&bench);
}

/* A closed room whose walls all emit 1 and reflect 0.6: the same everywhere, at all wavelengths. */
static void a_white_furnace_stays_white(void **state)
{
    (void)state;
    blob_material_t wall = {.kind = MATERIAL_DIFFUSE};
    wall.values[VALUE_REFLECTANCE] = blob_constant(0.6f);
    test_scene_t scene = test_scene_begin(vec3(0.3f, 0.2f, 0.1f), 70, 16);
    test_scene_room(&scene, vec3(-1, -1.5f, -2), vec3(2, 1, 3), test_scene_material(&scene, wall),
                    vec3(1, 1, 1));
    test_scene_finish(&scene);
    const double truth = (1 - pow(0.6, scene.blob.scene->max_depth + 1)) / 0.4;
    estimate_image_t image = render(&scene.blob, INTEGRATOR_BDPT, 256, true);
    size_t pixels = (size_t)(image.width * image.height);
    for (size_t c = 0; c < 3; c++) {
        double mean = 0, variance = 0;
        for (size_t i = 0; i < pixels; i++) {
            mean += image.mean[3 * i + c] / (double)pixels;
            variance += image.variance[3 * i + c] / (double)(pixels * pixels);
        }
        print_message("furnace %zu: %.4f +- %.4f for %.4f\n", c, mean, sqrt(variance), truth);
        assert_true(fabs(mean - truth) < 4.5 * sqrt(variance) + 0.002 && sqrt(variance) < 0.01 * truth);
    }
    estimate_image_free(&image);
    test_scene_end(&scene);
}

/* The layer shows what RGB shows of a coloured wall, not the wavelengths. */
static void albedo_is_a_colour(void **state)
{
    (void)state;
    blob_material_t wall = {.kind = MATERIAL_DIFFUSE};
    wall.values[VALUE_REFLECTANCE] = blob_colour_value(vec3(0.8f, 0.3f, 0.1f));
    test_scene_t scene = test_scene_begin(vec3(0, 0, 0), 70, 8);
    test_scene_room(&scene, vec3(-1, -1, -1), vec3(1, 1, 1), test_scene_material(&scene, wall),
                    vec3(1, 1, 1));
    test_scene_finish(&scene);
    job_settings_t settings = blob_default_settings(&scene.blob);
    settings.spp = 2;
    settings.spectral = settings.features = true;
    film_t *film = render_here(&scene.blob, &settings);
    film_image_t image;
    film_resolve(film, &image);
    for (int i = 0; i < 64; i++) {
        assert_float_equal(image.albedo[3 * i], 0.8f, 1e-5f);
        assert_float_equal(image.albedo[3 * i + 2], 0.1f, 1e-5f);
    }
    film_image_free(&image);
    film_destroy(&film);
    test_scene_end(&scene);
}

static rgb_t mean_of(const estimate_image_t *image)
{
    size_t pixels = (size_t)(image->width * image->height);
    double sum[3] = {0};
    for (size_t i = 0; i < 3 * pixels; i++) sum[i % 3] += image->mean[i] / (double)pixels;
    return vec3((float)sum[0], (float)sum[1], (float)sum[2]);
}

/* A body shows the colour of its material, though nearly nothing of its strongest channel is absorbed. */
static void bodies_have_their_colours(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run(&bench,
              "LookAt 0 0 -9 0 0 0 0 1 0\nCamera \"perspective\" \"float fov\" [4]\n"
              "Film \"rgb\" \"integer xresolution\" [8] \"integer yresolution\" [8]\n"
              "Integrator \"volpath\" \"integer maxdepth\" [50]\nWorldBegin\n"
              "LightSource \"infinite\" \"rgb L\" [1 1 1]\n"
              "Material \"subsurface\" \"rgb reflectance\" [0.8 0.3 0.1] \"rgb mfp\" [0.02 0.02 0.02]\n"
              "Shape \"sphere\" \"float radius\" [1]\n");
    if (bench.result.code != RESULT_OK) fail_msg("%s", bench.result.message);
    estimate_image_t rgb = render(&bench.blob, INTEGRATOR_BDPT, 64, false),
                     spectral = render(&bench.blob, INTEGRATOR_BDPT, 64, true);
    rgb_t wanted = mean_of(&rgb), seen = mean_of(&spectral);
    print_message("body: %.4f %.4f %.4f, in RGB %.4f %.4f %.4f\n", (double)seen.x, (double)seen.y,
                  (double)seen.z, (double)wanted.x, (double)wanted.y, (double)wanted.z);
    assert_true(worst_of(seen, wanted) < 0.06 * (double)wanted.x);
    estimate_image_free(&rgb);
    estimate_image_free(&spectral);
    bench_close(&bench);
}

/* The camera stands in absorbing glass of index 1, in front of a white wall: light has the colour that it is
 * to have after that distance. */
static void glass_leaves_its_colour(void **state)
{
    (void)state;
    const rgb_t colour = {0.9f, 0.3f, 0.1f};
    const float distance = 2;
    blob_material_t glass = {.kind = MATERIAL_GLTF}, black = {.kind = MATERIAL_DIFFUSE};
    for (material_value_t v = 0; v < MATERIAL_VALUES; v++) glass.values[v] = blob_constant(0);
    glass.values[VALUE_REFLECTANCE] = glass.values[VALUE_TRANSMISSION] = blob_constant(1);
    glass.values[VALUE_ETA] = blob_constant(1);
    glass.values[VALUE_ATTENUATION] = blob_colour_value(
        vec3(-logf(colour.x) / distance, -logf(colour.y) / distance, -logf(colour.z) / distance));
    glass.values[VALUE_THICKNESS] = blob_constant(distance);
    test_scene_t scene = test_scene_begin(vec3(0, 0, 0), 1, 4);
    uint32_t sheet = test_scene_material(&scene, glass), wall = test_scene_material(&scene, black);
    test_scene_rectangle(&scene, vec3(-9, -9, 2), vec3(18, 0, 0), vec3(0, 18, 0), sheet, vec3(0, 0, 0));
    test_scene_rectangle(&scene, vec3(-9, -9, 4), vec3(0, 18, 0), vec3(18, 0, 0), wall, vec3(1, 1, 1));
    test_scene_finish(&scene);
    for (int spectral = 0; spectral < 2; spectral++) {
        estimate_image_t image = render(&scene.blob, INTEGRATOR_PATH, 512, spectral);
        rgb_t seen = mean_of(&image);
        print_message("through glass: %.4f %.4f %.4f\n", (double)seen.x, (double)seen.y, (double)seen.z);
        assert_true(worst_of(seen, colour) < 0.01);
        estimate_image_free(&image);
    }
    test_scene_end(&scene);
}

static int begin(void **state)
{
    (void)state;
    tables = waves_tables_new();
    return 0;
}

static int end(void **state)
{
    (void)state;
    waves_tables_destroy(&tables);
    return 0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_colour_comes_back),        cmocka_unit_test(drawn_wavelengths_show_the_colour),
        cmocka_unit_test(lights_shine_by_their_spectra),  cmocka_unit_test(metals_have_their_colours),
        cmocka_unit_test(glass_refracts_each_wavelength), cmocka_unit_test(abbe_numbers_hold),
        cmocka_unit_test(films_interfere_by_wavelength),  cmocka_unit_test(greys_agree_with_rgb),
        cmocka_unit_test(a_white_furnace_stays_white),    cmocka_unit_test(albedo_is_a_colour),
        cmocka_unit_test(bodies_have_their_colours),      cmocka_unit_test(glass_leaves_its_colour),
    };
    return cmocka_run_group_tests(tests, begin, end);
}
