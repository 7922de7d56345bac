/* unit_mac: see unit_mac.h.
 *
 * DESIGN. A keyed BLAKE2b of what units are issued for gives the key of a SipHash-2-4 of the unit. The first
 * is made once a message; the second takes some 20 ns a unit. Both are libsodium's.
 *
 * Why a MAC a unit, and not one a list: a batch holds some units of many assignments. Lists would have to
 * come back whole, and would not fit into a control message. */
#include "proto/serve/unit_mac.h"

#include "common/atomic_file.h"

#include <sodium.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* ---- the secret ---------------------------------------------------------------------------------------- */

unit_secret_t unit_secret_new(void)
{
    unit_secret_t secret;
    randombytes_buf(secret.bytes, sizeof secret.bytes);
    return secret;
}

static result_t read_secret(const char *path, unit_secret_t *secret)
{
    uint8_t *bytes;
    size_t size;
    TRY(file_read(path, 4096, &bytes, &size));
    bool whole = size == sizeof secret->bytes;
    if (whole) memcpy(secret->bytes, bytes, size);
    sodium_memzero(bytes, size);
    free(bytes);
    if (whole) return result_ok();
    return result_fail(RESULT_INPUT,
                       "%s is damaged: delete it, and what workers have in hand is rendered once more", path);
}

static result_t make_secret(const char *path, unit_secret_t *secret)
{
    *secret = unit_secret_new();
    return file_write_private(path, secret->bytes, sizeof secret->bytes);
}

result_t unit_secret_load(const char *data_dir, unit_secret_t *secret)
{
    char *path = mem_printf("%s/keys/units", data_dir);
    result_t result = access(path, F_OK) == 0 ? read_secret(path, secret) : make_secret(path, secret);
    free(path);
    return result;
}

/* ---- MACs ---------------------------------------------------------------------------------------------- */

static void add_number(crypto_generichash_state *state, uint64_t number)
{
    uint8_t bytes[8];
    for (int i = 0; i < 8; i++) bytes[i] = (uint8_t)(number >> 8 * i);
    crypto_generichash_update(state, bytes, sizeof bytes);
}

unit_mac_t unit_mac(const unit_secret_t *secret, const char *party, uint64_t job, const hash_t *content,
                    uint64_t check)
{
    static_assert(sizeof((unit_mac_t *)0)->key == crypto_shorthash_KEYBYTES, "the key of a SipHash");
    unit_mac_t mac;
    crypto_generichash_state state;
    crypto_generichash_init(&state, secret->bytes, sizeof secret->bytes, sizeof mac.key);
    add_number(&state, job);
    add_number(&state, check);
    crypto_generichash_update(&state, content->bytes, sizeof content->bytes);
    crypto_generichash_update(&state, (const uint8_t *)party, strlen(party));
    crypto_generichash_final(&state, mac.key, sizeof mac.key);
    return mac;
}

static uint64_t mac_of(const unit_mac_t *mac, const unit_t *unit)
{
    uint8_t bytes[12], tag[crypto_shorthash_BYTES];
    const uint32_t fields[] = {unit->tile, unit->first, unit->count};
    uint64_t value = 0;
    for (int i = 0; i < 12; i++) bytes[i] = (uint8_t)(fields[i / 4] >> 8 * (i % 4));
    crypto_shorthash(tag, bytes, sizeof bytes, mac->key);
    for (int i = 0; i < 8; i++) value |= (uint64_t)tag[i] << 8 * i;
    return value;
}

void unit_mac_issue(const unit_mac_t *mac, const unit_t *units, size_t count, issue_t *issues)
{
    for (size_t i = 0; i < count; i++) issues[i] = (issue_t){.mac = mac_of(mac, &units[i])};
}

static bool was_issued(const unit_mac_t *mac, const unit_t *piece, const issue_t *issue)
{
    uint64_t count = (uint64_t)issue->before + piece->count + issue->after;
    if (piece->count == 0 || issue->before > piece->first || count > UINT32_MAX) return false;
    unit_t unit = {piece->tile, piece->first - issue->before, (uint32_t)count};
    return mac_of(mac, &unit) == issue->mac;
}

result_t unit_mac_check(const unit_mac_t *mac, const unit_t *units, const issue_t *issues, size_t count)
{
    for (size_t i = 0; i < count; i++)
        if (!was_issued(mac, &units[i], &issues[i]))
            return result_fail(RESULT_DENIED, "tile %u, samples %u + %u were not issued to who delivers them",
                               units[i].tile, units[i].first, units[i].count);
    return result_ok();
}
