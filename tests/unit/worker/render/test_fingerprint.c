/* The fingerprint of this machine's bits. With an argument the program prints it and ends. */
#include "tests/clock.h"
#include "worker/render/fingerprint.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static const char *program;

static hash_t take(void)
{
    hash_t hash;
    result_t result = renderer_fingerprint(&hash);
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
    return hash;
}

static void it_is_the_same_every_time(void **state)
{
    (void)state;
    hash_t first = take(), second = take(), none = {{0}};
    assert_true(hash_equal(&first, &second));
    assert_false(hash_equal(&first, &none));
}

/* The fingerprint of another process, with these variables in its environment. */
static void take_elsewhere(const char *environment, char text[2 * HASH_BYTES + 1])
{
    char *command = mem_printf("%s %s print", environment, program);
    FILE *out = popen(command, "r");
    assert_non_null(out);
    assert_non_null(fgets(text, 2 * HASH_BYTES + 1, out));
    assert_int_equal(pclose(out), 0);
    free(command);
}

static void it_is_the_same_in_another_process(void **state)
{
    (void)state;
    char here[2 * HASH_BYTES + 1], there[2 * HASH_BYTES + 1];
    hash_t hash = take();
    hash_to_hex(&hash, here);
    take_elsewhere("", there);
    assert_string_equal(here, there);
}

/* Without fused multiply-add, some functions of the C library round otherwise. */
static void another_c_library_shows(void **state)
{
    (void)state;
    char here[2 * HASH_BYTES + 1], there[2 * HASH_BYTES + 1];
    take_elsewhere("", here);
    take_elsewhere("GLIBC_TUNABLES=glibc.cpu.hwcaps=-FMA,-AVX2", there);
    assert_string_not_equal(here, there);
}

static void it_takes_no_time_to_speak_of(void **state)
{
    (void)state;
    double start = clock_cpu();
    take();
    double seconds = clock_cpu() - start;
    print_message("%.1f ms\n", 1e3 * seconds);
    assert_true(seconds < 3); /* 20 ms; a sanitizer may be at work */
}

int main(int argc, char **argv)
{
    if (argc > 1) {
        char text[2 * HASH_BYTES + 1];
        hash_t hash = take();
        hash_to_hex(&hash, text);
        puts(text);
        return 0;
    }
    program = argv[0];
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(it_is_the_same_every_time), cmocka_unit_test(it_is_the_same_in_another_process),
        cmocka_unit_test(another_c_library_shows), cmocka_unit_test(it_takes_no_time_to_speak_of)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
