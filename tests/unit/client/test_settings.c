/* What a command line's settings tell of the picture. */
#include "client/scene/loaded_scene.h"
#include "client/scene/settings.h"
#include "tests/scratch.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

/* What is logged for a scene and a size. */
static char *told(const char *folder, const scene_blob_t *blob, int32_t width, int32_t height)
{
    overrides_t overrides = overrides_none();
    overrides.width = width;
    overrides.height = height;
    scratch_capture_t capture = scratch_capture(folder, 2);
    settings_tell_cut(&overrides, blob);
    return scratch_uncapture(&capture);
}

static void another_aspect_says_what_it_cuts(void **state)
{
    (void)state;
    static const struct {
        int32_t width, height;
        const char *text; /* NULL: nothing is said */
    } cases[] = {{0, 0, NULL},
                 {800, 400, NULL},
                 {333, 167, NULL}, /* rounded */
                 {400, 400, "it shows 50 % of the width and 100 % of the height"},
                 {800, 200, "it shows 200 % of the width and 100 % of the height"},
                 {400, 800, "it shows 50 % of the width and 200 % of the height"}};
    char *folder = scratch_new();
    blob_scene_t scene = blob_default_scene();
    scene.width = 1600;
    scene.height = 800;
    scene_blob_t blob = {.scene = &scene};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        char *text = told(folder, &blob, cases[i].width, cases[i].height);
        if (cases[i].text == NULL)
            assert_string_equal(text, "");
        else if (strstr(text, cases[i].text) == NULL)
            fail_msg("%s", text);
        free(text);
    }
    scene.screen_window[0] = -2, scene.screen_window[1] = 2;
    scene.screen_window[2] = -1, scene.screen_window[3] = 1;
    char *text = told(folder, &blob, 400, 400);
    if (strstr(text, "stretched to 50 % of its width") == NULL) fail_msg("%s", text);
    free(text);
    scratch_destroy(&folder);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(another_aspect_says_what_it_cuts)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
