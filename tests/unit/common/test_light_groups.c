/* Light groups: what a user may write, what becomes of it, and what is refused with which words. */
#include "common/light_groups.h"

#include "common/scene/blob_format.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

static const grouped_light_t lights[] = {{LIGHT_INFINITE, NULL},
                                         {LIGHT_AREA, "room.pbrt:27"},
                                         {LIGHT_AREA, "parts/lamp.pbrt:3"},
                                         {LIGHT_AREA, "parts/lamp.pbrt:3"},
                                         {LIGHT_SPOT, ""},
                                         {LIGHT_AREA, "room.pbrt:127"}};
enum { LIGHTS = ARRAY_LENGTH(lights) };

static void what_is_written_is_resolved(void **state)
{
    (void)state;
    static const struct {
        const char *written, *resolved;
        uint8_t groups[LIGHTS];
    } cases[] = {{"sky=infinite", "sky=infinite,rest", {0, 1, 1, 1, 1, 1}},
                 {"a=area,b=spot+infinite", "a=area,b=spot+infinite", {1, 0, 0, 0, 1, 0}},
                 {"key=2-4,sky=0,rest", "key=2-4,sky=0,rest", {1, 2, 0, 0, 0, 2}},
                 {"all=0-5,rest", "all=0-5", {0, 0, 0, 0, 0, 0}},
                 {"lamps=area,key=2", "lamps=area,key=2,rest", {2, 0, 1, 0, 2, 0}}, /* a number wins, */
                 {"key=2,lamps=area", "key=2,lamps=area,rest", {2, 1, 0, 1, 2, 1}}, /* wherever it stands */
                 {"lamp=lamp.pbrt:3", "lamp=2-3,rest", {1, 1, 0, 0, 1, 1}},
                 {"lamp=parts/lamp.pbrt:3+4,r=room.pbrt:27", "lamp=2-3+4,r=1,rest", {2, 1, 0, 0, 0, 2}},
                 {"kinds", "infinite=infinite,area=area,spot=spot", {0, 1, 1, 1, 2, 1}},
                 {"each", "light0=0,light1=1,light2=2,light3=3,light4=4,light5=5", {0, 1, 2, 3, 4, 5}},
                 {"rest", "rest", {0, 0, 0, 0, 0, 0}}};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++) {
        char resolved[LIGHT_GROUPS_TEXT + 1];
        uint8_t groups[LIGHTS];
        assert_string_equal(light_groups_resolve(cases[i].written, lights, LIGHTS, resolved).message, "");
        assert_string_equal(resolved, cases[i].resolved);
        assert_string_equal(light_groups_assign(resolved, lights, LIGHTS, groups).message, "");
        assert_memory_equal(groups, cases[i].groups, sizeof groups);
    }
    char none[LIGHT_GROUPS_TEXT + 1];
    assert_int_equal(light_groups_resolve("", lights, LIGHTS, none).code, RESULT_OK);
    assert_string_equal(none, "");
    assert_int_equal(light_groups_count(none), 0);
}

static void groups_have_names_and_a_number(void **state)
{
    (void)state;
    static const char text[] = "sky=infinite,key-1=3+4,rest";
    static const char *const names[] = {"sky", "key-1", "rest", ""};
    assert_int_equal(light_groups_count(text), 3);
    for (uint32_t g = 0; g < ARRAY_LENGTH(names); g++) {
        char name[LIGHT_GROUP_NAME + 1];
        light_groups_name(text, g, name);
        assert_string_equal(name, names[g]);
    }
}

static void mistakes_are_named(void **state)
{
    (void)state;
    static const struct {
        const char *written, *says;
    } cases[] = {{"key", "write NAME=LIGHTS"},
                 {"=3", "'' names no light group"},
                 {"a b=3", "'a b' names no light group"},
                 {"abcdefghijklmnopq=3", "up to 16 letters"},
                 {"a=", "'' selects no lights"},
                 {"a=1+", "'' selects no lights"},
                 {"a=lamp", "'lamp' selects no lights"},
                 {"a=5-3", "'5-3' selects no lights"},
                 {"a=1234567890", "'1234567890' selects no lights"},
                 {"a=6", "no light '6'; it has infinite (0), area (1-3), spot (4), area (5)"},
                 {"a=0-6", "no light '0-6'"},
                 {"a=distant", "no light 'distant'"},
                 {"a=oom.pbrt:27", "no light 'oom.pbrt:27'"},
                 {"a=0,b=0", "light 0 is in the groups 'a' and 'b'"},
                 {"a=area,b=area", "light 1 is in the groups 'a' and 'b'"},
                 {"a=1,a=2", "two light groups 'a'"},
                 {"rest=1", "light group 'rest': write"},
                 {"rest,a=1", "light group 'rest': write"},
                 {"lamps=area,a=1-3,b=5", "no light of the scene is left for the light group 'lamps'"},
                 {"a=1,kinds", "light group 'kinds': write"},
                 {"a=0,b=1,c=2,d=3,e=4,f=5,g=0,h=1,i=2", "there are 9 light groups, and at most 8"}};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++) {
        char resolved[LIGHT_GROUPS_TEXT + 1];
        result_t result = light_groups_resolve(cases[i].written, lights, LIGHTS, resolved);
        assert_int_equal(result.code, RESULT_USAGE);
        if (strstr(result.message, cases[i].says) == NULL)
            fail_msg("%s: '%s' says not '%s'", cases[i].written, result.message, cases[i].says);
        assert_string_equal(resolved, "");
    }
}

static void too_much_is_refused(void **state)
{
    (void)state;
    grouped_light_t many[12];
    char resolved[LIGHT_GROUPS_TEXT + 1], text[2 * LIGHT_GROUPS_TEXT];
    for (size_t i = 0; i < ARRAY_LENGTH(many); i++) many[i] = (grouped_light_t){LIGHT_POINT, NULL};
    result_t result = light_groups_resolve("each", many, ARRAY_LENGTH(many), resolved);
    assert_non_null(
        strstr(result.message, "has 12 lights, and there can be at most 8 light groups: name some"));
    result = light_groups_resolve("a=0,b=1,c=2,d=3,e=4,f=5,g=6,h=7", many, ARRAY_LENGTH(many), resolved);
    assert_non_null(strstr(result.message, "there are 9 light groups")); /* the rest is one */
    size_t used = (size_t)snprintf(text, sizeof text, "a=0");
    while (used <= LIGHT_GROUPS_TEXT) used += (size_t)snprintf(text + used, sizeof text - used, "+1");
    result = light_groups_resolve(text, many, ARRAY_LENGTH(many), resolved);
    assert_non_null(strstr(result.message, "more than 511 bytes"));
    assert_non_null(strstr(light_groups_check(text).message, "the limit is 511"));
    assert_non_null(strstr(light_groups_resolve("a=0", many, 0, resolved).message, "no lights"));
}

/* A job's settings may come from anybody. */
static void settings_are_checked_against_the_scene(void **state)
{
    (void)state;
    uint8_t groups[LIGHTS];
    static const char *const bad[] = {
        "a=0", "a=0-5,rest", "a=0,b=6", "a=area,b=spot", "kinds", "a=0,b=0,rest", "a=room.pbrt:27,rest"};
    for (size_t i = 0; i < ARRAY_LENGTH(bad); i++)
        assert_int_equal(light_groups_assign(bad[i], lights, LIGHTS, groups).code, RESULT_USAGE);
    assert_int_equal(light_groups_check("a=0,b=17,rest").code, RESULT_OK); /* without the scene */
    assert_int_equal(light_groups_check("each").code, RESULT_USAGE);
    assert_int_equal(light_groups_check("a=room.pbrt:27,rest").code, RESULT_USAGE);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(what_is_written_is_resolved), cmocka_unit_test(groups_have_names_and_a_number),
        cmocka_unit_test(mistakes_are_named), cmocka_unit_test(too_much_is_refused),
        cmocka_unit_test(settings_are_checked_against_the_scene)};
    return cmocka_run_group_tests_name("light groups", tests, NULL, NULL);
}
