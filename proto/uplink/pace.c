/* pace: see pace.h.
 *
 * DESIGN. A batch is made of tiles, whose bytes go with the pixels of its units, and of frames (splats),
 * whose bytes go with its samples as long as they fall into empty pixels, and end when all are full. So
 * longer batches are cheaper by the sample only when they come near the full frame: at 1920 x 1080 that is
 * some 30 MB, at 1 Mbit/s four minutes.
 *
 * A slow link is one that does not carry in a batch interval what the threads make in one. There batches are
 * closed when they take a quarter of an interval to send, and two such are in hand: one under way, and one
 * that fills. That keeps the link busy, counts soon, and leaves little for others to render again at the end
 * of the job. Where the full frame takes no more than two intervals, and the job has lasted for twice that
 * time, so that it will probably last as long again, batches may grow to it instead.
 *
 * Units are as large as half a batch, within what a thread renders in a quarter of an interval: without
 * splats a unit takes the same bytes whatever its samples. */
#include "proto/uplink/pace.h"

#include <math.h>

static const double FULL_BATCH = 2;     /* intervals that one with full frames may take to be sent, */
static const double SHORT_BATCH = 0.25; /* and another */
static const double LEAST_BATCH = 3;    /* and one with the smallest unit, which is worth no more than that */
static const double CODED = 0.35;       /* of the bytes of sums are left, roughly */
static const double SPLAT_BYTES = 8;    /* of a path of one more vertex, roughly */
static const double NEWEST = 0.3;       /* share of the newest batch in a mean */

static double mix(double mean, double newest, bool learned)
{
    return learned ? mean + NEWEST * (newest - mean) : newest;
}

void load_add(load_t *load, const job_settings_t *settings, const unit_t *unit)
{
    load->samples += (double)unit_samples(settings, unit);
    load->pixels += job_tile_pixels(settings, unit->tile);
}

void pace_rest(pace_t *pace, double now)
{
    job_settings_t usual = job_settings_default();
    usual.width = 1920;
    usual.height = 1080;
    pace_begin(pace, &usual, now);
}

void pace_begin(pace_t *pace, const job_settings_t *settings, double now)
{
    const unit_t unit = {0, 0, 1};
    double pixels = (double)settings->width * settings->height;
    pace->begun = now;
    pace->learned = false;
    pace->tile_pixels = job_tile_pixels(settings, unit.tile);
    pace->tile_bytes = CODED * (double)sum_unit_bytes(settings, &unit) / pace->tile_pixels;
    pace->frame_bytes = job_has_splats(settings) ? CODED * (double)sum_frame_bytes(settings) : 0;
    double planes = pace->frame_bytes / (CODED * pixels * 6 * sizeof(int64_t));
    pace->sample_bytes = planes * SPLAT_BYTES * (settings->max_depth + 1);
}

void pace_learn(pace_t *pace, const load_t *load, const uint64_t bytes[BATCH_SUMS])
{
    double tiles = 0, frames = 0;
    for (int s = 0; s < BATCH_SUMS; s++) *(film_sums[s].frame ? &frames : &tiles) += (double)bytes[s];
    if (load->samples <= 0) return;
    pace->tile_bytes = mix(pace->tile_bytes, tiles / load->pixels, pace->learned);
    pace->frame_bytes = fmax(pace->frame_bytes, frames);
    bool thin = frames < 0.25 * pace->frame_bytes;
    double a_sample = frames / load->samples;
    if (thin || a_sample > pace->sample_bytes)
        pace->sample_bytes = mix(pace->sample_bytes, a_sample, pace->learned);
    pace->learned = true;
}

double pace_bytes(const pace_t *pace, const load_t *load)
{
    return fmin(pace->frame_bytes, pace->sample_bytes * load->samples) + pace->tile_bytes * load->pixels;
}

bool pace_is_slow(const pace_t *pace, double speed, double unit_samples)
{
    double samples = speed * pace->interval, each = fmax(unit_samples, pace->tile_pixels);
    load_t made = {samples, samples / each * pace->tile_pixels};
    return pace->rate > 0 && pace_bytes(pace, &made) > pace->rate * pace->interval;
}

/* True when batches may grow to full frames. */
static bool grows(const pace_t *pace, double now)
{
    double full = pace->frame_bytes / pace->rate; /* seconds */
    return full > 0 && full <= FULL_BATCH * pace->interval && now - pace->begun >= 2 * full;
}

double pace_batch_bytes(const pace_t *pace, double now)
{
    return pace->rate * pace->interval * (grows(pace, now) ? FULL_BATCH : SHORT_BATCH);
}

double pace_unit_samples(const pace_t *pace, double now, double thread_speed)
{
    double most = SHORT_BATCH * pace->interval * thread_speed;
    double splats = 0.5 * pace_batch_bytes(pace, now) - pace->tile_bytes * pace->tile_pixels;
    if (pace->sample_bytes > 0) most = fmin(most, splats / pace->sample_bytes);
    return fmax(most, pace->tile_pixels);
}

double pace_wanted(const pace_t *pace, double now, const load_t *next, double unit_samples)
{
    double room = pace_batch_bytes(pace, now) - pace_bytes(pace, next);
    double samples = fmax(unit_samples, pace->tile_pixels);
    double each = pace->sample_bytes + pace->tile_bytes * pace->tile_pixels / samples;
    if (room <= 0 && next->samples > 0) return 0;
    return fmax(each > 0 ? room / each : 0, pace->tile_pixels); /* one unit in any case */
}

double pace_hopeless(const pace_t *pace)
{
    const load_t least = {pace->tile_pixels, pace->tile_pixels};
    double seconds = pace->rate > 0 ? pace_bytes(pace, &least) / pace->rate : 0;
    return pace->learned && seconds > LEAST_BATCH * pace->interval ? seconds : 0;
}
