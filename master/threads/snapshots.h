/* snapshots: the files of images that clients fetch, in DATA/snapshots, as long as they are fetched.
 *
 * A snapshot is named by what it shows: job, number of batches, format. So people who look at one job share
 * one file: while nothing was counted since, and while one that took long to make is not older than that, so
 * that whoever asks again, or at about the same time, does not have it made once more.
 *
 * Their number and their bytes are bounded. Those that nobody reads any more make room.
 *
 * Thread-safe.
 */
#ifndef LIGHTMILL_SNAPSHOTS_H
#define LIGHTMILL_SNAPSHOTS_H

#include "common/base.h"

enum {
    SNAPSHOTS_MAX = 16,
    SNAPSHOTS_KEEP = 60 /* seconds after the last use */
};

/* How a snapshot is written. */
typedef struct {
    bool half;      /* EXR with half floats */
    bool halves;    /* EXR with the two halves of the picture */
    bool png;       /* not an EXR but a PNG, 8 bits sRGB, */
    float exposure; /* brightened by so many stops */
} image_format_t;
bool image_format_equal(const image_format_t *a, const image_format_t *b);

/* What it shows. */
typedef struct {
    uint64_t job;
    uint64_t version; /* of the film (farm_image_version) when it was taken; 0 of a milestone */
    bool over;        /* the job's last image, or a milestone's */
    image_format_t format;
    uint32_t at; /* samples a pixel of a milestone; 0: the image as it was */
} image_key_t;

typedef struct {
    uint64_t id; /* random, not 0 */
    image_key_t key;
    bool keep; /* the file stays when the snapshot goes, and is not in DATA/snapshots */
    char *path;
    uint64_t size;  /* bytes */
    double seconds; /* that it took to make */
} snapshot_t;

/* A file for who is told by a call. */
typedef struct {
    int descriptor;   /* open for reading, the receiver's to close */
    uint64_t size;    /* bytes */
    uint64_t version; /* of its key */
    bool over;        /* likewise */
} image_file_t;

typedef struct snapshots snapshots_t;

/* An empty set whose files, but those that stay, take so many bytes at most; 0: any number. What an earlier
 * process left in the directory goes. */
result_t snapshots_new(const char *data_dir, uint64_t limit, snapshots_t **snapshots);
/* Deletes the files, frees everything and sets *snapshots to NULL. */
void snapshots_free(snapshots_t **snapshots);

/* One that shows this, or something that is fresh enough, whatever its version is; 0: there is none. It is
 * being used now. */
uint64_t snapshots_find(snapshots_t *snapshots, double now, const image_key_t *key);
/* Gives a new one its id; and a path in fresh memory, unless its file stays. */
void snapshots_name(const snapshots_t *snapshots, snapshot_t *snapshot);
/* How many bytes the file of a new one may take. To have room for `largest` those that nobody reads go, the
 * least recently used first. RESULT_LIMIT, with what to do about it, when there is no room at all. */
result_t snapshots_room(snapshots_t *snapshots, double now, uint64_t largest, uint64_t *room);
/* Why a file that would have been larger than that cannot be had. */
result_t snapshots_refusal(snapshots_t *snapshots);
/* Takes one over that was made, with its path. If there are too many, the least recently used goes. */
void snapshots_put(snapshots_t *snapshots, double now, const snapshot_t *snapshot);
/* Somebody was told of it and will read it to its end. */
void snapshots_give(snapshots_t *snapshots, uint64_t id);
/* Deletes those that were not used for SNAPSHOTS_KEEP. */
void snapshots_drop_old(snapshots_t *snapshots, double now);

/* Reads up to `length` bytes at `offset`; *length says how many there were, *size the file's size.
 * RESULT_INPUT when the snapshot is gone or the offset beyond its end. */
result_t snapshots_read(snapshots_t *snapshots, double now, uint64_t id, uint64_t offset, void *bytes,
                        size_t *length, uint64_t *size);
/* Opens its file, which outlives it. */
result_t snapshots_open(snapshots_t *snapshots, uint64_t id, image_file_t *file);

#endif
