/* Tests of proto/serve/unit_mac.h and proto/uplink/issued.h: what was issued comes back with what shows it,
 * whole and in pieces, and nothing else passes. */
#include "proto/serve/unit_mac.h"
#include "proto/uplink/issued.h"
#include "tests/scratch.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

static const hash_t content = {{1, 2, 3}};

static unit_mac_t mac_of(uint8_t secret, const char *party, uint64_t job, uint64_t check)
{
    return unit_mac(&(unit_secret_t){{secret}}, party, job, &content, check);
}

static bool passes(const unit_mac_t *mac, unit_t unit, issue_t issue)
{
    result_t result = unit_mac_check(mac, &unit, &issue, 1);
    if (result.code != RESULT_OK) assert_int_equal(result.code, RESULT_DENIED);
    return result.code == RESULT_OK;
}

static void a_mac_is_for_one_purpose(void **state)
{
    (void)state;
    const unit_t unit = {7, 16, 8};
    issue_t issue;
    unit_mac_t mac = mac_of(1, "key a", 3, 0), same = mac_of(1, "key a", 3, 0);
    unit_mac_issue(&mac, &unit, 1, &issue);
    assert_true(passes(&same, unit, issue));
    hash_t another = content;
    another.bytes[31] ^= 1;
    const unit_mac_t others[] = {
        mac_of(2, "key a", 3, 0), mac_of(1, "key b", 3, 0),
        mac_of(1, "key ", 3, 0),  mac_of(1, "", 3, 0),
        mac_of(1, "key a", 4, 0), mac_of(1, "key a", 3, 1),
        mac_of(1, "key a", 0, 3), unit_mac(&(unit_secret_t){{1}}, "key a", 3, &another, 0)};
    for (size_t i = 0; i < ARRAY_LENGTH(others); i++) assert_false(passes(&others[i], unit, issue));
    for (int bit = 0; bit < 64; bit++)
        assert_false(passes(&mac, unit, (issue_t){.mac = issue.mac ^ (uint64_t)1 << bit}));
}

static void pieces_pass_and_what_lies_outside_does_not(void **state)
{
    (void)state;
    const unit_t unit = {7, 16, 8}, first = {0, 0, 4};
    issue_t issue, at_first;
    unit_mac_t mac = mac_of(1, "a", 3, 0);
    unit_mac_issue(&mac, &unit, 1, &issue);
    unit_mac_issue(&mac, &first, 1, &at_first);
    for (uint32_t before = 0; before < 8; before++)
        for (uint32_t count = 1; before + count <= 8; count++)
            assert_true(passes(&mac, (unit_t){7, 16 + before, count},
                               (issue_t){issue.mac, before, 8 - before - count}));
    const struct {
        unit_t unit;
        uint32_t before, after;
    } wrong[] = {{{6, 16, 8}, 0, 0},
                 {{7, 17, 8}, 0, 0},
                 {{7, 16, 9}, 0, 0},
                 {{7, 16, 7}, 0, 0},
                 {{7, 15, 9}, 0, 0},
                 {{7, 17, 8}, 1, UINT32_MAX}, /* the sums would come round to the unit */
                 {{7, 0, 8}, UINT32_MAX - 15, 0},
                 {{7, 16, 0}, 0, 8},
                 {{7, 20, 0}, 4, 4},
                 {{7, 24, UINT32_MAX - 7}, 8, 8}};
    for (size_t i = 0; i < ARRAY_LENGTH(wrong); i++)
        assert_false(passes(&mac, wrong[i].unit, (issue_t){issue.mac, wrong[i].before, wrong[i].after}));
    assert_false(passes(&mac, (unit_t){0, 2, 4}, (issue_t){at_first.mac, 2, UINT32_MAX - 1}));
    /* One wrong among many, which is named. */
    const unit_t units[] = {unit, first, {5, 1, 2}};
    const issue_t issues[] = {issue, at_first, issue};
    assert_int_equal(unit_mac_check(&mac, units, issues, 2).code, RESULT_OK);
    assert_non_null(strstr(unit_mac_check(&mac, units, issues, 3).message, "tile 5, samples 1 + 2"));
}

static void the_secret_stays_in_its_file(void **state)
{
    (void)state;
    char *folder = scratch_new();
    unit_secret_t made, read, fresh = unit_secret_new();
    assert_int_equal(unit_secret_load(folder, &made).code, RESULT_OK);
    assert_int_equal(unit_secret_load(folder, &read).code, RESULT_OK);
    assert_memory_equal(&made, &read, sizeof made);
    assert_memory_not_equal(&made, &fresh, sizeof made);
    char *path = mem_printf("%s/keys/units", folder);
    struct stat status;
    assert_int_equal(stat(path, &status), 0);
    assert_int_equal(status.st_mode & 0777, 0600);
    assert_int_equal(status.st_size, sizeof made);
    assert_int_equal(truncate(path, 31), 0);
    result_t result = unit_secret_load(folder, &read);
    assert_int_equal(result.code, RESULT_INPUT);
    assert_non_null(strstr(result.message, path));
    assert_non_null(strstr(result.message, "delete it"));
    free(path);
    scratch_destroy(&folder);
}

/* ---- what a worker remembers --------------------------------------------------------------------------- */

static issue_t find(issued_t *issued, unit_t unit)
{
    issue_t issue;
    issued_find(issued, &unit, 1, &issue);
    return issue;
}

static void pieces_are_found_in_what_was_issued(void **state)
{
    (void)state;
    issued_t issued = {0};
    const unit_t units[] = {{5, 8, 4}, {0, 0, 16}, {5, 0, 8}};
    const uint64_t macs[] = {10, 11, 12};
    assert_true(find(&issued, units[0]).mac == 0);
    issued_add(&issued, units, macs, 3);
    for (int i = 0; i < 3; i++) assert_true(find(&issued, units[i]).mac == macs[i]);
    issue_t piece = find(&issued, (unit_t){5, 9, 2});
    assert_true(piece.mac == 10 && piece.before == 1 && piece.after == 1);
    assert_true(find(&issued, (unit_t){5, 7, 2}).mac == 0); /* of two */
    assert_true(find(&issued, (unit_t){1, 0, 1}).mac == 0);
    assert_true(find(&issued, (unit_t){0, 15, 2}).mac == 0);
    /* Issued once more, otherwise cut: the last time counts, as far as it goes. */
    const unit_t again[] = {{5, 4, 6}, {0, 0, 16}};
    issued_add(&issued, again, (uint64_t[]){20, 21}, 2);
    assert_true(find(&issued, (unit_t){5, 5, 2}).mac == 20);
    assert_true(find(&issued, (unit_t){5, 0, 8}).mac == 12);
    assert_true(find(&issued, (unit_t){5, 0, 2}).mac == 12);
    assert_true(find(&issued, (unit_t){5, 10, 2}).mac == 10);
    assert_true(find(&issued, units[1]).mac == 21);
    issued_add(&issued, again, NULL, 2); /* nothing is known of these */
    assert_true(find(&issued, units[1]).mac == 21);
    issued_free(&issued);
}

/* In random lives, each unit in hand is found, and what is not in hand is forgotten. */
static void what_is_in_hand_is_remembered(void **state)
{
    (void)state;
    enum { TILES = 5, SAMPLES = 400, ROUNDS = 300 };
    unsigned seed = 4;
    issued_t issued = {0};
    unit_t held[1000];
    size_t count = 0, most = 0;
    uint32_t next[TILES] = {0};
    for (int round = 0; round < ROUNDS; round++) {
        for (int i = 0; i < 3; i++) {
            uint32_t tile = (uint32_t)rand_r(&seed) % TILES;
            unit_t unit = {tile, next[tile], 2 + (uint32_t)rand_r(&seed) % 6};
            uint64_t mac = (uint64_t)tile << 32 | (uint64_t)unit.first << 8 | unit.count;
            issued_add(&issued, &unit, &mac, 1);
            next[tile] += unit.count;
            /* In two pieces. */
            held[count++] = (unit_t){tile, unit.first, 1};
            held[count++] = (unit_t){tile, unit.first + 1, unit.count - 1};
        }
        while (count > 40) held[(size_t)rand_r(&seed) % count] = held[count - 1], count--;
        if (round % 3 == 0) issued_keep(&issued, held, count);
        if (issued.count > most) most = issued.count;
        for (size_t i = 0; i < count; i++) {
            issue_t issue = find(&issued, held[i]);
            uint64_t whole = (uint64_t)held[i].tile << 32 | (uint64_t)(held[i].first - issue.before) << 8 |
                             (issue.before + held[i].count + issue.after);
            assert_true(issue.mac == whole);
        }
    }
    assert_in_range(most, 20, 40 + 12);
    issued_keep(&issued, NULL, 0);
    assert_int_equal(issued.count, 0);
    assert_true(find(&issued, held[0]).mac == 0);
    issued_free(&issued);
}

int main(void)
{
    log_init("test", LOG_ERROR);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_mac_is_for_one_purpose),
        cmocka_unit_test(pieces_pass_and_what_lies_outside_does_not),
        cmocka_unit_test(the_secret_stays_in_its_file),
        cmocka_unit_test(pieces_are_found_in_what_was_issued),
        cmocka_unit_test(what_is_in_hand_is_remembered),
    };
    return cmocka_run_group_tests_name("unit mac", tests, NULL, NULL);
}
