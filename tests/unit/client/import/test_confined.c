/* confined: work gives its result, or fails by itself; it reaches nothing but memory and its result, and this
 * process outlives it. */
#include "client/import/packed/confined.h"

#include <errno.h>
#include <fcntl.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include <cmocka.h>

static const confined_limits_t limits = {.memory = (uint64_t)64 << 20, .seconds = 1};

/* Runs the work and returns how it ended; what it wrote is in *result. */
static int run(confined_work_t *work, const void *context, confined_result_t *result)
{
    result_t done = confined_run(work, context, &limits, result);
    assert_string_equal(done.message, "");
    return result->failure;
}

/* The same where nothing comes back. */
static int end_of(confined_work_t *work, const void *context)
{
    confined_result_t result;
    int end = run(work, context, &result);
    confined_free(&result);
    return end;
}

/* ---- work ---------------------------------------------------------------------------------------------- */

static int write_twice(const void *context, int output)
{
    size_t length = strlen(context);
    char *copy = malloc(length + 1);
    strcpy(copy, context);
    for (int i = 0; i < 2; ++i)
        if (write(output, copy, length) != (ssize_t)length) return 1;
    free(copy);
    return 0;
}

static int give_up(const void *context, int output)
{
    (void)output;
    return *(const int *)context;
}

static int fault(const void *context, int output)
{
    (void)context, (void)output;
    raise(SIGSEGV); /* which is refused, too */
    __builtin_trap();
}

static int abort_itself(const void *context, int output)
{
    (void)context, (void)output;
    abort();
}

static int never_end(const void *context, int output)
{
    (void)output;
    while (*(const volatile int *)context) continue;
    return 0;
}

/* Returns the number of the first thing that it may do and should not. `context`: a file that is open to read
 * and write. */
static int try_all(const void *context, int output)
{
    int file = *(const int *)context;
    char byte = 0;
    if (open("/dev/null", O_RDONLY) >= 0) return 1;
    if (socket(AF_INET, SOCK_STREAM, 0) >= 0) return 2;
    if (fork() >= 0) return 3;
    if (kill(getppid(), 0) == 0) return 4;
    if (write(file, &byte, 1) == 1) return 5;
    if (write(STDERR_FILENO, &byte, 1) == 1) return 6;
    if (read(file, &byte, 1) >= 0) return 7;
    if (mmap(NULL, 1, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0) != MAP_FAILED) return 8;
    if (execl("/bin/true", "true", (char *)NULL) == 0) return 9;
    if (unlink("/nothing") == 0 || errno != EPERM) return 10;
    if (mmap(NULL, 2 * limits.memory, PROT_READ, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0) != MAP_FAILED) return 11;
    return write(output, &byte, 1) == 1 ? 0 : 12;
}

static int write_without_end(const void *context, int output)
{
    (void)context;
    static const char block[1 << 16];
    while (write(output, block, sizeof block) > 0) continue;
    return 1;
}

/* ---- tests --------------------------------------------------------------------------------------------- */

static void its_result_comes_back(void **state)
{
    (void)state;
    confined_result_t result;
    assert_int_equal(run(write_twice, "twice ", &result), 0);
    assert_int_equal(result.size, 12);
    assert_memory_equal(result.data, "twice twice ", 12);
    confined_free(&result);
    assert_null(result.data);
    for (int code = 0; code < 100; code += 33) assert_int_equal(end_of(give_up, &code), code);
}

static void faults_end_it_alone(void **state)
{
    (void)state;
    assert_int_equal(end_of(fault, NULL), -1);
    assert_int_equal(end_of(abort_itself, NULL), -1);
}

static void time_and_the_size_of_the_result_are_limited(void **state)
{
    (void)state;
    struct timespec from, to;
    clock_gettime(CLOCK_MONOTONIC, &from);
    assert_int_equal(end_of(never_end, &(int){1}), -1);
    clock_gettime(CLOCK_MONOTONIC, &to);
    assert_true(to.tv_sec - from.tv_sec <= 12);
    confined_result_t result;
    assert_int_equal(run(write_without_end, NULL, &result), -1);
    assert_true(result.size <= limits.memory);
    confined_free(&result);
}

static void it_reaches_nothing_else(void **state)
{
    (void)state;
    int file = memfd_create("open", MFD_CLOEXEC);
    assert_int_equal(ftruncate(file, 4096), 0);
    assert_int_equal(end_of(try_all, &file), 0);
    close(file);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(its_result_comes_back),
        cmocka_unit_test(faults_end_it_alone),
        cmocka_unit_test(time_and_the_size_of_the_result_are_limited),
        cmocka_unit_test(it_reaches_nothing_else),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
