/* spool: see spool.h.
 *
 * A file is
 *
 *     8 bytes   "LMSPOOL1"
 *     hash      of the head
 *     head      head_t, the units, the sender's name and party without their NULs
 *     payloads  eye tiles, splat frame, features
 *
 * in the byte order of x86, which is all that this runs on. The head has the hash of the payloads, so that it
 * can be read without them. "LMSPOOL2" has one payload more, and so on (payload_count): their sizes, a u64
 * each, are at the end of the head. */
#include "master/store/spool.h"

#include "common/file_io.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static const char MAGIC[7] = {'L', 'M', 'S', 'P', 'O', 'O', 'L'}; /* and a digit */

typedef struct {
    uint64_t job;
    hash_t fingerprint, payload_hash;
    film_counts_t counts;
    uint64_t payload_size[BATCH_BASE_PAYLOADS];
    uint32_t unit_count;
    uint16_t name_size, party_size;
} head_t;

static_assert(sizeof(film_counts_t) == 6 * sizeof(uint64_t), "files of earlier versions have these counts");

enum {
    HASH_OFFSET = sizeof MAGIC + 1,
    HEAD_OFFSET = HASH_OFFSET + HASH_BYTES,
    MAX_HEAD = HEAD_OFFSET + sizeof(head_t) + WIRE_MAX_UNITS * sizeof(unit_t) + JOB_MAX_NAME +
               SPOOL_MAX_PARTY + (BATCH_PAYLOADS - BATCH_BASE_PAYLOADS) * sizeof(uint64_t)
};

void spool_head_free(spool_head_t *head)
{
    free(head->units);
    head->units = NULL;
    head->unit_count = 0;
}

/* ---- names --------------------------------------------------------------------------------------------- */

static const char *const kinds[] = {
    [SPOOL_KEPT] = "kept", [SPOOL_CHECK] = "check", [SPOOL_WRONG] = "wrong", [SPOOL_OUT] = "out"};

static char *job_folder(const char *dir, uint64_t job)
{
    return mem_printf("%s/job-%" PRIu64, dir, job);
}

static char *file_path(const char *dir, uint64_t job, const spool_name_t *name)
{
    char out[20] = "";
    if (name->kind == SPOOL_OUT) snprintf(out, sizeof out, "-%016" PRIx64, name->out_clock);
    return mem_printf("%s/job-%" PRIu64 "/%016" PRIx64 "-%016" PRIx64 "%s.%s", dir, job, name->clock,
                      name->serial, out, kinds[name->kind]);
}

/* Reads 16 hexadecimal digits and the character after them. */
static bool read_number(const char **text, char after, uint64_t *number)
{
    if (strspn(*text, "0123456789abcdef") != 16 || (*text)[16] != after) return false;
    *number = strtoull(*text, NULL, 16);
    *text += 17;
    return true;
}

static bool name_read(const char *text, spool_name_t *name)
{
    *name = (spool_name_t){.kind = SPOOL_KEPT};
    if (!read_number(&text, '-', &name->clock)) return false;
    bool out = read_number(&text, '-', &name->serial);
    if (!read_number(&text, '.', out ? &name->out_clock : &name->serial)) return false;
    while (name->kind < SPOOL_NONE && strcmp(text, kinds[name->kind]) != 0) name->kind++;
    return out ? name->kind == SPOOL_OUT : name->kind < SPOOL_OUT;
}

/* ---- writing ------------------------------------------------------------------------------------------- */

static hash_t hash_payloads(const zmq_msg_t payload[BATCH_PAYLOADS])
{
    hash_t hashes[BATCH_PAYLOADS];
    size_t count = (size_t)payload_count(payload);
    for (size_t i = 0; i < count; i++)
        hashes[i] = hash_bytes(zmq_msg_data((zmq_msg_t *)&payload[i]), zmq_msg_size(&payload[i]));
    return hash_bytes(hashes, count * sizeof *hashes);
}

static size_t head_size(const spool_head_t *head, const zmq_msg_t payload[BATCH_PAYLOADS])
{
    return HEAD_OFFSET + sizeof(head_t) + head->unit_count * sizeof *head->units + strlen(head->name) +
           strlen(head->party) + ((size_t)payload_count(payload) - BATCH_BASE_PAYLOADS) * sizeof(uint64_t);
}

/* The bytes in front of the payloads, in fresh memory. */
static uint8_t *encode_head(uint64_t job, const spool_head_t *head, const zmq_msg_t payload[BATCH_PAYLOADS],
                            size_t *size)
{
    head_t fixed = {.job = job,
                    .fingerprint = head->fingerprint,
                    .payload_hash = hash_payloads(payload),
                    .counts = head->counts,
                    .unit_count = (uint32_t)head->unit_count,
                    .name_size = (uint16_t)strlen(head->name),
                    .party_size = (uint16_t)strlen(head->party)};
    uint64_t sizes[BATCH_PAYLOADS];
    for (int i = 0; i < BATCH_PAYLOADS; i++) sizes[i] = zmq_msg_size(&payload[i]);
    memcpy(fixed.payload_size, sizes, sizeof fixed.payload_size);
    size_t more = (size_t)payload_count(payload) - BATCH_BASE_PAYLOADS, more_bytes = more * sizeof *sizes;
    size_t units = head->unit_count * sizeof *head->units;
    *size = head_size(head, payload);
    uint8_t *bytes = mem_alloc(*size), *at = bytes + HEAD_OFFSET;
    memcpy(at, &fixed, sizeof fixed);
    memcpy(at += sizeof fixed, head->units, units);
    memcpy(at += units, head->name, fixed.name_size);
    memcpy(at += fixed.name_size, head->party, fixed.party_size);
    memcpy(at + fixed.party_size, sizes + BATCH_BASE_PAYLOADS, more_bytes);
    hash_t hash = hash_bytes(bytes + HEAD_OFFSET, *size - HEAD_OFFSET);
    memcpy(bytes, MAGIC, sizeof MAGIC);
    bytes[sizeof MAGIC] = (uint8_t)('1' + more);
    memcpy(bytes + HASH_OFFSET, &hash, sizeof hash);
    return bytes;
}

/* Makes the folders too. */
static int create_file(const char *dir, uint64_t job, const char *path)
{
    char *folder = job_folder(dir, job);
    mkdir(dir, 0700); /* where that fails, so does the file, unless they are there */
    mkdir(folder, 0700);
    free(folder);
    return open(path, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
}

uint64_t spool_size(const spool_head_t *head, const zmq_msg_t payload[BATCH_PAYLOADS])
{
    uint64_t size = head_size(head, payload);
    for (int i = 0; i < BATCH_PAYLOADS; i++) size += zmq_msg_size(&payload[i]);
    return size;
}

result_t spool_write(const char *dir, uint64_t job, const spool_name_t *name, const spool_head_t *head,
                     const zmq_msg_t payload[BATCH_PAYLOADS])
{
    char *path = file_path(dir, job, name);
    int file = create_file(dir, job, path);
    result_t result = result_ok();
    if (file < 0) {
        result = result_fail(RESULT_IO, "cannot make %s: %s", path, strerror(errno));
    } else {
        size_t size;
        uint8_t *bytes = encode_head(job, head, payload, &size);
        bool good = file_write_all(file, bytes, size);
        for (int i = 0; i < BATCH_PAYLOADS && good; i++)
            good = file_write_all(file, zmq_msg_data((zmq_msg_t *)&payload[i]), zmq_msg_size(&payload[i]));
        if (!good) result = result_fail(RESULT_IO, "cannot write %s: %s", path, strerror(errno));
        close(file);
        free(bytes);
        if (!good) unlink(path);
    }
    free(path);
    return result;
}

/* ---- reading ------------------------------------------------------------------------------------------- */

static result_t bad(const char *what)
{
    return result_fail(RESULT_INPUT, "a spooled batch is damaged: %s", what);
}

/* How many payloads there are beyond those of every batch; too many when it is no spooled batch. */
static size_t more_payloads(const uint8_t *bytes)
{
    if (memcmp(bytes, MAGIC, sizeof MAGIC) != 0 || bytes[sizeof MAGIC] < '1') return BATCH_PAYLOADS;
    return (size_t)bytes[sizeof MAGIC] - '1';
}

/* The fixed part and the sizes of the payloads, when head and sizes are whole. */
static result_t check_head(const uint8_t *bytes, size_t present, uint64_t size, head_t *fixed,
                           uint64_t sizes[BATCH_PAYLOADS], size_t *head_size)
{
    if (present < HEAD_OFFSET + sizeof *fixed || more_payloads(bytes) > BATCH_PAYLOADS - BATCH_BASE_PAYLOADS)
        return bad("it does not begin like one");
    memcpy(fixed, bytes + HEAD_OFFSET, sizeof *fixed);
    if (fixed->unit_count == 0 || fixed->unit_count > WIRE_MAX_UNITS || fixed->name_size > JOB_MAX_NAME ||
        fixed->party_size > SPOOL_MAX_PARTY)
        return bad("its head is out of all bounds");
    size_t more_bytes = more_payloads(bytes) * sizeof *sizes;
    *head_size = HEAD_OFFSET + sizeof *fixed + fixed->unit_count * sizeof(unit_t) + fixed->name_size +
                 fixed->party_size + more_bytes;
    if (present < *head_size) return bad("its head is cut short");
    hash_t hash = hash_bytes(bytes + HEAD_OFFSET, *head_size - HEAD_OFFSET);
    if (memcmp(&hash, bytes + HASH_OFFSET, sizeof hash) != 0) return bad("the checksum of its head differs");
    memset(sizes, 0, BATCH_PAYLOADS * sizeof *sizes);
    memcpy(sizes, fixed->payload_size, sizeof fixed->payload_size);
    memcpy(sizes + BATCH_BASE_PAYLOADS, bytes + *head_size - more_bytes, more_bytes);
    uint64_t left = size - *head_size;
    for (int i = 0; i < BATCH_PAYLOADS; i++) {
        if (sizes[i] > left || sizes[i] > WIRE_MAX_PAYLOAD) return bad("its payloads are cut short");
        left -= sizes[i];
    }
    return left == 0 ? result_ok() : bad("there is more than its payloads");
}

result_t spool_decode(const uint8_t *bytes, size_t present, uint64_t size, uint64_t job,
                      const job_settings_t *settings, spool_head_t *head, uint64_t offset[BATCH_PAYLOADS],
                      uint64_t length[BATCH_PAYLOADS], hash_t *payload_hash)
{
    head_t fixed;
    size_t head_size = 0;
    *head = (spool_head_t){.units = NULL};
    TRY(check_head(bytes, present, size, &fixed, length, &head_size));
    if (fixed.job != job) return bad("it is another job's");
    const uint8_t *units = bytes + HEAD_OFFSET + sizeof fixed;
    const uint8_t *text = units + fixed.unit_count * sizeof(unit_t);
    for (uint32_t i = 0; i < fixed.unit_count; i++) {
        unit_t unit;
        memcpy(&unit, units + i * sizeof unit, sizeof unit);
        if (!job_unit_valid(settings, &unit)) return bad("its units do not lie in the job");
    }
    *head = (spool_head_t){.fingerprint = fixed.fingerprint,
                           .counts = fixed.counts,
                           .units = mem_alloc(fixed.unit_count * sizeof(unit_t)),
                           .unit_count = fixed.unit_count};
    memcpy(head->units, units, fixed.unit_count * sizeof(unit_t));
    memcpy(head->name, text, fixed.name_size);
    memcpy(head->party, text + fixed.name_size, fixed.party_size);
    *payload_hash = fixed.payload_hash;
    uint64_t at = head_size;
    for (int i = 0; i < BATCH_PAYLOADS; i++) {
        offset[i] = at;
        at += length[i];
    }
    return result_ok();
}

static result_t read_payloads(int file, const uint64_t offset[BATCH_PAYLOADS],
                              const uint64_t length[BATCH_PAYLOADS], const hash_t *hash,
                              zmq_msg_t payload[BATCH_PAYLOADS])
{
    result_t result = result_ok();
    for (int i = 0; i < BATCH_PAYLOADS; i++) zmq_msg_init(&payload[i]);
    for (int i = 0; i < BATCH_PAYLOADS && result.code == RESULT_OK; i++) {
        if (zmq_msg_init_size(&payload[i], length[i]) != 0) {
            zmq_msg_init(&payload[i]);
            result = result_fail(RESULT_LIMIT, "no memory for a batch of %" PRIu64 " bytes", length[i]);
        } else if (!file_read_all(file, zmq_msg_data(&payload[i]), length[i], offset[i])) {
            result = bad("it cannot be read");
        }
    }
    if (result.code == RESULT_OK) {
        hash_t found = hash_payloads(payload);
        if (!hash_equal(&found, hash)) result = bad("the checksum of its sums differs");
    }
    for (int i = 0; i < BATCH_PAYLOADS && result.code != RESULT_OK; i++) zmq_msg_close(&payload[i]);
    return result;
}

/* Payloads NULL: not wanted. */
static result_t read_file(int file, uint64_t job, const job_settings_t *settings, spool_head_t *head,
                          zmq_msg_t *payload)
{
    struct stat status;
    uint64_t offset[BATCH_PAYLOADS], length[BATCH_PAYLOADS];
    hash_t hash;
    if (fstat(file, &status) != 0 || status.st_size < 0) return bad("it cannot be read");
    uint64_t size = (uint64_t)status.st_size;
    size_t present = size < MAX_HEAD ? (size_t)size : MAX_HEAD;
    uint8_t *bytes = mem_alloc(present + 1);
    result_t result = file_read_all(file, bytes, present, 0)
                          ? spool_decode(bytes, present, size, job, settings, head, offset, length, &hash)
                          : bad("it cannot be read");
    free(bytes);
    if (result.code != RESULT_OK || payload == NULL) return result;
    result = read_payloads(file, offset, length, &hash, payload);
    if (result.code != RESULT_OK) spool_head_free(head);
    return result;
}

result_t spool_read(const char *dir, uint64_t job, const spool_name_t *name, const job_settings_t *settings,
                    spool_head_t *head, zmq_msg_t payload[BATCH_PAYLOADS])
{
    char *path = file_path(dir, job, name);
    int file = open(path, O_RDONLY | O_CLOEXEC);
    *head = (spool_head_t){.units = NULL};
    result_t result = file < 0 ? result_fail(RESULT_IO, "cannot open %s: %s", path, strerror(errno))
                               : read_file(file, job, settings, head, payload);
    if (file >= 0) close(file);
    free(path);
    return result;
}

result_t spool_read_head(const char *dir, uint64_t job, const spool_name_t *name,
                         const job_settings_t *settings, spool_head_t *head)
{
    return spool_read(dir, job, name, settings, head, NULL);
}

/* ---- files and folders --------------------------------------------------------------------------------- */

result_t spool_rename(const char *dir, uint64_t job, const spool_name_t *from, const spool_name_t *to)
{
    char *old = file_path(dir, job, from), *new = file_path(dir, job, to);
    result_t result = result_ok();
    if (rename(old, new) != 0)
        result = result_fail(errno == ENOSPC || errno == EDQUOT ? RESULT_LIMIT : RESULT_IO,
                             "cannot rename %s: %s", old, strerror(errno));
    free(old);
    free(new);
    return result;
}

void spool_delete(const char *dir, uint64_t job, const spool_name_t *name)
{
    char *path = file_path(dir, job, name);
    if (unlink(path) != 0 && errno != ENOENT) log_warning("cannot delete %s: %s", path, strerror(errno));
    free(path);
}

static int name_order(const void *a, const void *b)
{
    const spool_name_t *m = a, *n = b;
    if (m->clock != n->clock) return m->clock < n->clock ? -1 : 1;
    return m->serial < n->serial ? -1 : m->serial > n->serial;
}

spool_name_t *spool_list(const char *dir, uint64_t job, size_t *count)
{
    char *path = job_folder(dir, job);
    DIR *folder = opendir(path);
    spool_name_t *names = NULL, name;
    size_t capacity = 0;
    *count = 0;
    for (const struct dirent *entry; folder != NULL && (entry = readdir(folder)) != NULL;) {
        if (!name_read(entry->d_name, &name)) continue;
        if (*count == capacity) names = mem_realloc(names, (capacity = 2 * capacity + 16) * sizeof *names);
        struct stat status;
        if (fstatat(dirfd(folder), entry->d_name, &status, 0) == 0) name.bytes = (uint64_t)status.st_size;
        names[(*count)++] = name;
    }
    if (folder != NULL) closedir(folder);
    free(path);
    if (*count > 0) qsort(names, *count, sizeof *names, name_order);
    return names;
}

uint64_t *spool_jobs(const char *dir, size_t *count)
{
    DIR *folder = opendir(dir);
    uint64_t *jobs = NULL;
    *count = 0;
    for (const struct dirent *entry; folder != NULL && (entry = readdir(folder)) != NULL;) {
        char *end;
        if (strncmp(entry->d_name, "job-", 4) != 0) continue;
        uint64_t job = strtoull(entry->d_name + 4, &end, 10);
        if (job == 0 || *end != '\0') continue;
        jobs = mem_realloc(jobs, (*count + 1) * sizeof *jobs);
        jobs[(*count)++] = job;
    }
    if (folder != NULL) closedir(folder);
    return jobs;
}

void spool_delete_job(const char *dir, uint64_t job)
{
    char *path = job_folder(dir, job);
    directory_clear(path);
    if (rmdir(path) != 0 && errno != ENOENT) log_warning("cannot delete %s: %s", path, strerror(errno));
    free(path);
}

result_t spool_sync(const char *dir)
{
    int folder = open(dir, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    result_t result = result_ok();
    if (folder < 0 && errno == ENOENT) return result; /* nothing was ever written */
    if (folder < 0 || syncfs(folder) != 0)
        result = result_fail(RESULT_IO, "cannot write out %s: %s", dir, strerror(errno));
    if (folder >= 0) close(folder);
    return result;
}
