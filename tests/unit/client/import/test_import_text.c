/* Numbers, tokens and transforms: the ground the importer stands on. */
#include "tests/unit/client/import/test_import.h"

#include "client/import/files/number.h"
#include "client/import/pbrt/syntax/lexer.h"
#include "client/import/scene/affine.h"

static void check_number(const char *text)
{
    double value = -1, expected = strtod(text, NULL);
    const char *end = text + strlen(text);
    assert_ptr_equal(number_parse(text, end, &value), end);
    assert_memory_equal(&value, &expected, sizeof value);
}

static void numbers_are_rounded_as_strtod_does(void **state)
{
    (void)state;
    static const char *const texts[] = {"0",
                                        "-0",
                                        "1",
                                        "+1",
                                        "-17",
                                        ".5",
                                        "5.",
                                        "0.1",
                                        "3.14159265358979",
                                        "1e10",
                                        "1E-10",
                                        "1e+22",
                                        "1e23",
                                        "9007199254740993",
                                        "0.000000000000123",
                                        "123456789012345678901234567890",
                                        "2.2250738585072011e-308",
                                        "4.9e-324",
                                        "1.7976931348623157e308",
                                        "0.30000000000000004",
                                        "1e-400",
                                        "00000000000000000000000000000012.5",
                                        "8.5e22",
                                        "-73.00000000000000000001"};
    for (size_t i = 0; i < ARRAY_LENGTH(texts); ++i) check_number(texts[i]);
    uint64_t seed = 1;
    for (int i = 0; i < 20000; ++i) {
        char text[64];
        seed = seed * 6364136223846793005u + 1442695040888963407u;
        double value = ldexp((double)(int64_t)seed, (int)(seed >> 58) - 80);
        snprintf(text, sizeof text, i % 3 == 0 ? "%.9g" : i % 3 == 1 ? "%.17g" : "%f", value);
        check_number(text);
    }
}

static void what_is_no_number_is_not_read(void **state)
{
    (void)state;
    static const char *const texts[] = {"", "-", ".", "e5", "1e", "1e+", "nan", "inf", "-inf", "1e999", "x1"};
    double value;
    for (size_t i = 0; i < ARRAY_LENGTH(texts); ++i)
        assert_null(number_parse(texts[i], texts[i] + strlen(texts[i]), &value));
    const char *hex = "0x10"; /* the number is the 0 before the x */
    assert_ptr_equal(number_parse(hex, hex + 4, &value), hex + 1);
    const char *cut = "125"; /* never reads beyond its end */
    assert_ptr_equal(number_parse(cut, cut + 2, &value), cut + 2);
    expect_near(value, 12, 0);
}

static void tokens_know_their_places(void **state)
{
    (void)state;
    const char *text = "Shape # \"comment\n \"a b\"[1 -2.5e1]\n\tWord\"\\\"q\\\\\"";
    lexer_t lexer = lexer_begin("f", text, strlen(text));
    static const struct {
        token_kind_t kind;
        const char *text;
        uint32_t line, column;
    } expected[] = {
        {TOKEN_WORD, "Shape", 1, 1}, {TOKEN_STRING, "a b", 2, 2},       {TOKEN_OPEN, "[", 2, 7},
        {TOKEN_WORD, "1", 2, 8},     {TOKEN_WORD, "-2.5e1", 2, 10},     {TOKEN_CLOSE, "]", 2, 16},
        {TOKEN_WORD, "Word", 3, 2},  {TOKEN_STRING, "\\\"q\\\\", 3, 6}, {TOKEN_END, "", 3, 13},
        {TOKEN_END, "", 3, 13},
    };
    for (size_t i = 0; i < ARRAY_LENGTH(expected); ++i) {
        token_t token;
        assert_int_equal(lexer_next(&lexer, &token).code, RESULT_OK);
        assert_int_equal(token.kind, expected[i].kind);
        assert_true(token_is(&token, expected[i].text));
        assert_int_equal(token.at.line, expected[i].line);
        assert_int_equal(token.at.column, expected[i].column);
        if (i == 7) {
            char plain[16];
            assert_int_equal(token_unescape(&token, plain).code, RESULT_OK);
            assert_string_equal(plain, "\"q\\");
        }
    }
}

static void bad_tokens_are_refused_with_their_place(void **state)
{
    (void)state;
    static const struct {
        const char *text, *message;
    } cases[] = {
        {"  \"open", "f:1:3: this string has no closing quote on its line"},
        {"\"over\nlines\"", "f:1:1: this string has no closing quote"},
        {"\"end\\", "f:1:1: this string has no closing quote"},
        {"ab\001c", "f:1:1: a byte 1"},
        {"\"a\001\"", "f:1:1: this string holds a control character"},
    };
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        lexer_t lexer = lexer_begin("f", cases[i].text, strlen(cases[i].text));
        token_t token;
        expect_text(lexer_next(&lexer, &token).message, cases[i].message);
    }
    token_t token = {.kind = TOKEN_STRING, .text = "a\\x", .length = 3, .at = {"f", 1, 1}};
    char plain[8];
    expect_text(token_unescape(&token, plain).message, "f:1:1: unknown escape \\x");
}

static void transforms_multiply_and_invert(void **state)
{
    (void)state;
    affine_t t, inverse;
    const double z[3] = {0, 0, 2}, offset[3] = {1, 2, 3};
    assert_true(affine_rotation(90, z, &t));
    expect_vec3(affine_point(&t, vec3(1, 0, 0)), 0, 1, 0);
    assert_true(affine_rotation(-450, z, &t));
    expect_vec3(affine_point(&t, vec3(1, 0, 0)), 0, -1, 0);
    affine_t move = affine_translation(offset), both = affine_multiply(&move, &t);
    expect_vec3(affine_point(&both, vec3(1, 0, 0)), 1, 1, 3);
    assert_true(affine_invert(&both, &inverse));
    expect_vec3(affine_point(&inverse, vec3(1, 1, 3)), 1, 0, 0);

    const double stretch[3] = {1, 2, -4};
    affine_t scale = affine_scaling(stretch);
    expect_near(affine_determinant(&scale), -8, 0);
    assert_true(affine_invert(&scale, &inverse));
    expect_vec3(affine_normal(&inverse, vec3(0, 1, 1)), 0, 2 / sqrt(5), -1 / sqrt(5));
    expect_vec3(affine_normal(&inverse, vec3(0, 0, 0)), 0, 0, 0);

    const double flat[3] = {1, 0, 1};
    scale = affine_scaling(flat);
    assert_false(affine_invert(&scale, &inverse));
    const double none[3] = {0, 0, 0};
    assert_false(affine_rotation(10, none, &t));
}

static void look_at_sees_its_target_along_z(void **state)
{
    (void)state;
    const double eye[3] = {1, 0, 0}, target[3] = {5, 0, 0}, up[3] = {0, 0, 1};
    affine_t camera_from_world;
    assert_true(affine_look_at(eye, target, up, &camera_from_world));
    expect_vec3(affine_point(&camera_from_world, vec3(1, 0, 0)), 0, 0, 0);
    expect_vec3(affine_point(&camera_from_world, vec3(3, 0, 0)), 0, 0, 2); /* looks down +z */
    expect_vec3(affine_point(&camera_from_world, vec3(1, 0, 1)), 0, 1, 0); /* y up */
    expect_vec3(affine_point(&camera_from_world, vec3(1, 1, 0)), 1, 0, 0); /* x = y cross z: left-handed */
    assert_false(affine_look_at(eye, eye, up, &camera_from_world));
    const double along[3] = {-3, 0, 0};
    assert_false(affine_look_at(eye, target, along, &camera_from_world));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(numbers_are_rounded_as_strtod_does),
        cmocka_unit_test(what_is_no_number_is_not_read),
        cmocka_unit_test(tokens_know_their_places),
        cmocka_unit_test(bad_tokens_are_refused_with_their_place),
        cmocka_unit_test(transforms_multiply_and_invert),
        cmocka_unit_test(look_at_sees_its_target_along_z),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
