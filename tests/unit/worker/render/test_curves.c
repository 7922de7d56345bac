/* What is looked up on curves: u runs along them, and v from 0 to 1 across ribbons. */
#include "tests/render_here.h"
#include "tests/unit/client/import/test_import.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

enum { SIDE = 16 };

/* The albedo of a ribbon that fills the picture, and has u for red and v for green. */
static void a_ribbon_has_all_of_its_texture(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run(&bench,
              "LookAt 0 0 -4  0 0 0  0 1 0\nCamera \"orthographic\" \"float screenwindow\" [-1 1 -1 1]\n"
              "Film \"image\" \"integer xresolution\" 16 \"integer yresolution\" 16\nWorldBegin\n"
              "LightSource \"infinite\"\nTexture \"t\" \"spectrum\" \"uv\"\n"
              "Material \"matte\" \"texture Kd\" \"t\"\n"
              "Shape \"curve\" \"string type\" \"ribbon\" \"float width\" 2 \"normal N\" [0 0 -1 0 0 -1]\n"
              "\"point P\" [-1 0 0  -.3333 0 0  .3333 0 0  1 0 0]\nWorldEnd\n");
    bench_expect_ok(&bench);
    job_settings_t settings = blob_default_settings(&bench.blob);
    settings.spp = 1;
    settings.features = true;
    film_t *film = render_here(&bench.blob, &settings);
    film_image_t image;
    float low[2] = {1, 1}, high[2] = {0, 0};
    film_resolve(film, &image);
    for (size_t i = 0; i < SIDE * SIDE; i++)
        for (size_t c = 0; c < 2; c++) {
            low[c] = float_min(low[c], image.albedo[3 * i + c]);
            high[c] = float_max(high[c], image.albedo[3 * i + c]);
        }
    print_message("u from %g to %g, v from %g to %g\n", (double)low[0], (double)high[0], (double)low[1],
                  (double)high[1]);
    for (size_t c = 0; c < 2; c++) assert_true(low[c] < 0.08f && high[c] > 0.92f);
    film_image_free(&image);
    film_destroy(&film);
    bench_close(&bench);
}

/* Hair on a ribbon knows where across it a ray meets: it is not the same everywhere. */
static void hair_on_a_ribbon_varies_across(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run(&bench,
              "LookAt 0 0 -4  0 0 0  0 1 0\nCamera \"orthographic\" \"float screenwindow\" [-1 1 -1 1]\n"
              "Film \"image\" \"integer xresolution\" 16 \"integer yresolution\" 16\nWorldBegin\n"
              "LightSource \"distant\" \"point from\" [0 1 -1]\n"
              "Material \"hair\" \"rgb color\" [0.5 0.3 0.2]\n"
              "Shape \"curve\" \"string type\" \"ribbon\" \"float width\" 2 \"normal N\" [0 0 -1 0 0 -1]\n"
              "\"point P\" [-1 0 0  -.3333 0 0  .3333 0 0  1 0 0]\nWorldEnd\n");
    bench_expect_ok(&bench);
    job_settings_t settings = blob_default_settings(&bench.blob);
    settings.spp = 1;
    film_t *film = render_here(&bench.blob, &settings);
    film_image_t image;
    film_resolve(film, &image);
    double top = (double)image.sum[3 * (SIDE * 2 + 8)], bottom = (double)image.sum[3 * (SIDE * 13 + 8)];
    print_message("top %g, bottom %g\n", top, bottom);
    assert_true(top > 0 && bottom > 0 && !(top / bottom > 0.9 && top / bottom < 1.1));
    film_image_free(&image);
    film_destroy(&film);
    bench_close(&bench);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(a_ribbon_has_all_of_its_texture),
                                       cmocka_unit_test(hair_on_a_ribbon_varies_across)};
    return cmocka_run_group_tests_name("curves", tests, NULL, NULL);
}
