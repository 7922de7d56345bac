/* quarters: see quarters.h. */
#include "tests/quarters.h"

#include "tests/render_here.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>

#include <cmocka.h>

quarters_t quarters_of(const scene_blob_t *blob, integrator_t integrator, uint32_t spp)
{
    job_settings_t settings = blob_default_settings(blob);
    settings.integrator = integrator;
    settings.spp = spp;
    settings.seed = 5;
    film_t *film = render_here(blob, &settings);
    film_image_t image;
    film_resolve(film, &image);
    assert_int_equal(film->counts.dropped, 0);
    quarters_t q = {0};
    const int width = (int)settings.width, height = (int)settings.height;
    const double share = (double)QUARTERS / width / height;
    for (int i = 0; i < width * height; ++i) {
        int part = (i % width >= width / 2) + 2 * (i / width >= height / 2);
        double noise = (double)image.noise[3 * i];
        q.mean[part] += (double)image.sum[3 * i] * share;
        q.error[part] += noise * noise * share * share;
    }
    for (int i = 0; i < QUARTERS; ++i) q.error[i] = sqrt(q.error[i]);
    film_image_free(&image);
    film_destroy(&film);
    return q;
}

void quarters_expect_same(const char *what, const quarters_t *a, const quarters_t *b, double most)
{
    for (int i = 0; i < QUARTERS; ++i) {
        double error = hypot(a->error[i], b->error[i]);
        if (!(fabs(a->mean[i] - b->mean[i]) < 4.5 * error && error < most * b->mean[i]))
            fail_msg("%s, quarter %d: %g +- %g and %g +- %g", what, i, a->mean[i], a->error[i], b->mean[i],
                     b->error[i]);
    }
}
