/* fuzz_spool: any bytes as a batch on the disk, with the checksums that they should have. What is accepted
 * lies in the job, and its payloads in the file. */
#include "tests/fuzz/fuzz.h"

#include "master/store/spool.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

/* The layout, as spool.c has it. */
enum {
    VERSION = 7,
    HEAD_HASH = 8,
    HEAD = HEAD_HASH + HASH_BYTES,
    PAYLOAD_HASH = HEAD + 40,
    PAYLOAD_SIZES = HEAD + 120,
    UNIT_COUNT = HEAD + 144,
    NAME_SIZE = HEAD + 148,
    KEY_SIZE = HEAD + 150,
    FIXED = HEAD + 152
};

static uint64_t number_at(const uint8_t *at, size_t bytes)
{
    uint64_t number = 0;
    memcpy(&number, at, bytes);
    return number;
}

/* Puts the checksums right, as far as the sizes allow it. */
static void mend(uint8_t *bytes, size_t size)
{
    if (size < FIXED || bytes[VERSION] < '1' || bytes[VERSION] > '1' + BATCH_PAYLOADS - BATCH_BASE_PAYLOADS)
        return;
    size_t payloads = BATCH_BASE_PAYLOADS + (size_t)bytes[VERSION] - '1';
    uint64_t more = FIXED + 12 * number_at(bytes + UNIT_COUNT, 4) + number_at(bytes + NAME_SIZE, 2) +
                    number_at(bytes + KEY_SIZE, 2);
    uint64_t head = more + 8 * (payloads - BATCH_BASE_PAYLOADS);
    if (head > size) return;
    hash_t hashes[BATCH_PAYLOADS];
    uint64_t at = head;
    for (size_t i = 0; i < payloads; i++) {
        bool base = i < BATCH_BASE_PAYLOADS;
        uint64_t length =
            number_at(base ? bytes + PAYLOAD_SIZES + 8 * i : bytes + more + 8 * (i - BATCH_BASE_PAYLOADS), 8);
        if (length > size - at) break;
        hashes[i] = hash_bytes(bytes + at, length);
        at += length;
        if (i < payloads - 1) continue;
        hash_t all = hash_bytes(hashes, payloads * sizeof *hashes);
        memcpy(bytes + PAYLOAD_HASH, &all, sizeof all);
    }
    hash_t hash = hash_bytes(bytes + HEAD, head - HEAD);
    memcpy(bytes + HEAD_HASH, &hash, sizeof hash);
}

/* Reads the bytes from a file, as a restart does. */
static void read_back(const uint8_t *bytes, size_t size, const job_settings_t *settings)
{
    char *dir = mem_strdup(fuzz_path("spool")), *folder = mem_printf("%s/job-1", dir);
    char *path = mem_printf("%s/0000000000000001-0000000000000001.kept", folder);
    mkdir(dir, 0700);
    mkdir(folder, 0700);
    FILE *file = fopen(path, "wb");
    fuzz_expect(file != NULL && fwrite(bytes, 1, size, file) == size, "a file to read");
    fclose(file);
    size_t count;
    spool_name_t *names = spool_list(dir, 1, &count);
    fuzz_expect(count == 1, "one batch");
    spool_head_t head;
    zmq_msg_t payload[BATCH_PAYLOADS];
    if (spool_read(dir, 1, &names[0], settings, &head, payload).code == RESULT_OK) {
        for (int i = 0; i < BATCH_PAYLOADS; i++) zmq_msg_close(&payload[i]);
        spool_head_free(&head);
    }
    spool_delete_job(dir, 1);
    free(names);
    free(path);
    free(folder);
    free(dir);
}

int fuzz_spool(const uint8_t *data, size_t size)
{
    job_settings_t settings = job_settings_default();
    settings.width = settings.height = 64;
    settings.spp = 64;
    uint8_t *bytes = mem_alloc(size + 1);
    memcpy(bytes, data, size);
    mend(bytes, size);
    spool_head_t head;
    uint64_t offset[BATCH_PAYLOADS], length[BATCH_PAYLOADS];
    hash_t hash;
    result_t result = spool_decode(bytes, size, size, 1, &settings, &head, offset, length, &hash);
    if (result.code == RESULT_OK) {
        fuzz_expect(head.unit_count > 0 && head.unit_count <= WIRE_MAX_UNITS, "a number of units");
        for (size_t i = 0; i < head.unit_count; i++)
            fuzz_expect(job_unit_valid(&settings, &head.units[i]), "a unit of the job");
        for (int i = 0; i < BATCH_PAYLOADS; i++)
            fuzz_expect(offset[i] <= size && length[i] <= size - offset[i], "a payload in the file");
        fuzz_expect(strlen(head.name) <= JOB_MAX_NAME && strlen(head.party) <= SPOOL_MAX_PARTY, "names");
    } else {
        fuzz_expect(result.message[0] != '\0' && head.units == NULL, "an error's leftovers");
    }
    spool_head_free(&head);
    read_back(bytes, size, &settings);
    free(bytes);
    return 0;
}
