/* fuzz_allow_list: any bytes as a list of keys and as a key file. What is accepted holds valid keys only,
 * which are found again. */
#include "tests/fuzz/fuzz.h"

#include "proto/serve/allow_list.h"
#include "proto/wire/keys.h"

#include <string.h>

static void check_list(const char *text, size_t size)
{
    allow_list_t list;
    result_t result = allow_list_parse(text, size, "list", &list);
    fuzz_expect(result.code == RESULT_OK || (strncmp(result.message, "list:", 5) == 0 && list.count == 0),
                "an error that does not name its line");
    for (size_t i = 0; i < list.count; i++) {
        const allow_entry_t *entry = &list.entries[i];
        fuzz_expect(key_valid(entry->key), "a key that is none");
        fuzz_expect(entry->rights != 0 && (entry->rights & ~(unsigned)RIGHTS_ALL) == 0, "no right");
        fuzz_expect(strlen(entry->name) <= KEY_MAX_NAME, "a name over the limit");
        fuzz_expect(allow_list_find(&list, entry->key) == entry, "a key that is not found");
    }
    allow_list_free(&list);
}

static void check_key_file(const char *text, size_t size)
{
    key_pair_t pair;
    result_t result = key_file_parse(text, size, "file", &pair);
    if (result.code == RESULT_OK) {
        fuzz_expect(key_valid(pair.open), "a public key that is none");
        fuzz_expect(pair.secret[0] == '\0' || key_valid(pair.secret), "a secret key that is none");
    } else {
        fuzz_expect(strncmp(result.message, "file:", 5) == 0 && pair.secret[0] == '\0',
                    "an error's leftovers");
    }
}

int fuzz_allow_list(const uint8_t *data, size_t size)
{
    const char *text = size > 0 ? (const char *)data : "";
    check_list(text, size);
    check_key_file(text, size);
    return 0;
}
