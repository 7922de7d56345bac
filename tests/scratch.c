/* scratch: see scratch.h. */
#include "tests/scratch.h"

#include "common/base.h"

#include <dirent.h>
#include <fcntl.h>
#include <ftw.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static void require(bool condition, const char *what)
{
    if (condition) return;
    perror(what);
    abort();
}

char *scratch_new(void)
{
    const char *base = getenv("TMPDIR");
    char *folder = mem_printf("%s/lightmill-test-XXXXXX", base != NULL ? base : "/tmp");
    require(mkdtemp(folder) != NULL, folder);
    return folder;
}

static int remove_entry(const char *path, const struct stat *about, int type, struct FTW *position)
{
    (void)about, (void)type, (void)position;
    return remove(path);
}

void scratch_destroy(char **folder)
{
    if (*folder == NULL) return;
    require(nftw(*folder, remove_entry, 8, FTW_DEPTH | FTW_PHYS) == 0, *folder);
    free(*folder);
    *folder = NULL;
}

char *scratch_path(const char *folder, const char *name)
{
    return mem_printf("%s/%s", folder, name);
}

void scratch_write(const char *path, const void *data, size_t size)
{
    FILE *file = fopen(path, "wb");
    require(file != NULL, path);
    require(fwrite(data, 1, size, file) == size, path);
    require(fclose(file) == 0, path);
}

void scratch_write_light_image(const char *folder, const char *name, int width, int height, float spot)
{
    char header[64];
    size_t length = (size_t)snprintf(header, sizeof header, "PF\n%d %d\n-1.0\n", width, height);
    size_t size = length + 12 * (size_t)width * (size_t)height;
    uint8_t *bytes = mem_alloc(size);
    memcpy(bytes, header, length);
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++) {
            float s = ((float)x + 0.5f) / (float)width, t = ((float)y + 0.5f) / (float)height;
            float base = s < 0.25f ? 0 : 0.5f + 0.4f * sinf(9 * s) * cosf(7 * t);
            float more = x == width / 2 && y == height / 2 ? spot : 0;
            float rgb[3] = {base + more, base * t + more, 0.5f * (base + 1 - s)};
            memcpy(bytes + length + 12 * ((size_t)y * (size_t)width + (size_t)x), rgb, 12);
        }
    char *path = scratch_path(folder, name);
    scratch_write(path, bytes, size);
    free(path);
    free(bytes);
}

uint8_t *scratch_read(const char *path, size_t *size)
{
    uint8_t *data = NULL;
    result_t result = file_read(path, (size_t)1 << 30, &data, size);
    require(result.code == RESULT_OK, result.message);
    return data;
}

size_t scratch_count(const char *folder)
{
    DIR *entries = opendir(folder);
    require(entries != NULL, folder);
    size_t count = 0;
    for (const struct dirent *entry; (entry = readdir(entries)) != NULL;)
        count += strcmp(entry->d_name, ".") != 0 && strcmp(entry->d_name, "..") != 0;
    closedir(entries);
    return count;
}

scratch_capture_t scratch_capture(const char *folder, int stream)
{
    scratch_capture_t capture = {.stream = stream, .path = scratch_path(folder, "captured")};
    fflush(NULL);
    capture.saved = dup(stream);
    int file = open(capture.path, O_WRONLY | O_CREAT | O_TRUNC, 0600);
    require(file >= 0 && capture.saved >= 0 && dup2(file, stream) == stream, capture.path);
    close(file);
    return capture;
}

char *scratch_uncapture(scratch_capture_t *capture)
{
    fflush(NULL);
    require(dup2(capture->saved, capture->stream) == capture->stream, capture->path);
    close(capture->saved);
    size_t size;
    char *text = (char *)scratch_read(capture->path, &size); /* with a zero byte behind it */
    unlink(capture->path);
    free(capture->path);
    return text;
}
