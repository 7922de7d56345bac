/* milestones: images that are kept at sample counts (job_settings_t.save_at; see farm.h).
 *
 * DESIGN. A round ends at each milestone (master/schedule/next_round.h), and the next is not opened before
 * the image is on the disk, flushed. So no sample beyond a milestone is in anybody's hands before its image
 * is safe: the image is that of a job with so many samples, to the last bit, and there is no moment at which
 * a crash could lose it. After a restart the film is short of the milestone, or stands at it and the image is
 * written once more, or was allowed to go beyond, and then it was there. The price: workers wait for each
 * other, as at the end of a job, and for the file. A second film would not need that, but would double the
 * memory of the job, its checkpoints and the work of merging.
 *
 * job_t.milestone is the state of that image, in the words of job_image_t: none, due, writing, failed (due
 * again after a while), and none again when it is written. While it is anything else, the job is neither
 * planned further nor put away.
 *
 * Sums of a verified job that are found to be wrong later are taken out of the film, but not out of images
 * that were written before. */
#include "master/farm/parts.h"

#include <stdio.h>

enum { RETRY_SECONDS = 5 }; /* between attempts to write an image */

/* True when a whole round is counted, and is to stay, as far as is known. */
static bool stands_still(const job_t *job)
{
    bool doubted = job->film == FILM_OPEN ? trust_pending(job) : trust_wrong(job);
    return job->merging == 0 && !doubted && schedule_round_counted(job->schedule);
}

/* A job that is closed, and whose film is not what it was at the milestone: sums were taken out. */
static bool is_missed(const job_t *job)
{
    return job->milestone == IMAGE_DUE && job->film != FILM_OPEN && job->merging == 0 && !trust_wrong(job) &&
           !schedule_round_counted(job->schedule);
}

bool farm_milestone_waits(farm_t *farm, job_t *job)
{
    if (job->milestone == IMAGE_DUE) wake_up(farm->options.image_wake);
    if (job->milestone != IMAGE_NONE) return true;
    uint32_t spp = schedule_even_end(job->schedule);
    if (spp <= job->kept.saved || job_next_milestone(&job->kept.settings, spp - 1) != spp) return false;
    job->milestone = IMAGE_DUE;
    job->milestone_spp = spp;
    wake_up(farm->options.image_wake);
    return true;
}

void farm_milestone_installed(job_t *job)
{
    uint32_t start = schedule_round_start(job->schedule);
    const save_at_t *save_at = &job->kept.settings.save_at;
    job->milestone = IMAGE_NONE;
    for (uint32_t i = 0; i < save_at->count && save_at->spp[i] <= start; i++)
        if (job->kept.saved < save_at->spp[i]) job->kept.saved = save_at->spp[i];
}

void farm_milestone_closed(job_t *job, job_state_t outcome)
{
    if (job->milestone == IMAGE_FAILED) job->milestone = IMAGE_DUE;
    if (job->milestone == IMAGE_DUE && outcome == JOB_FAILED) job->milestone = IMAGE_NONE;
}

void farm_milestone_give_up(job_t *job)
{
    if (job->milestone != IMAGE_WRITING) job->milestone = IMAGE_NONE;
}

void farm_milestone_tick(farm_t *farm, double now, job_t *job)
{
    if (job->milestone != IMAGE_FAILED || now < job->milestone_retry) return;
    job->milestone = IMAGE_DUE;
    wake_up(farm->options.image_wake);
}

job_t *farm_next_milestone(farm_t *farm, uint32_t *spp)
{
    job_t *found = NULL;
    farm_lock(farm);
    for (size_t i = 0; i < farm->job_count && found == NULL; i++) {
        if (is_missed(farm->jobs[i])) farm->jobs[i]->milestone = IMAGE_NONE;
        if (farm->jobs[i]->milestone == IMAGE_DUE && stands_still(farm->jobs[i])) found = farm->jobs[i];
    }
    if (found != NULL) {
        found->milestone = IMAGE_WRITING;
        found->milestone_version = found->kept.batches;
        found->pins++;
        *spp = found->milestone_spp;
    }
    farm_unlock(farm);
    return found;
}

/* The image could not be written. A job that is over does not wait for it. */
static void fail(farm_t *farm, double now, job_t *job, const result_t *result)
{
    char text[260];
    snprintf(text, sizeof text, "the image at %u samples a pixel cannot be written: %.190s",
             job->milestone_spp, result->message);
    log_error("job %llu: %s", (unsigned long long)job->kept.job, text);
    if (job->film != FILM_OPEN) {
        job->milestone = IMAGE_NONE;
        farm_job_tell(farm, job, "%s", text);
        return;
    }
    job->milestone = IMAGE_FAILED;
    job->milestone_retry = now + RETRY_SECONDS;
    snprintf(job->remark, sizeof job->remark, "%s; the job waits, and it is tried again", text);
}

void farm_milestone_written(farm_t *farm, double now, job_t *job, result_t written, const char *path)
{
    farm_lock(farm);
    bool same = job->milestone_version == job->kept.batches && stands_still(job);
    if (written.code != RESULT_OK) {
        fail(farm, now, job, &written);
    } else {
        /* If sums were taken out meanwhile, it is due again when the round is whole. */
        job->milestone = IMAGE_NONE;
        if (same) {
            job->kept.saved = job->milestone_spp;
            job->remark[0] = '\0';
            farm_record_changed(farm, job);
            log_info("job %llu: the image at %u samples a pixel is in %s", (unsigned long long)job->kept.job,
                     job->milestone_spp, path);
        }
    }
    farm_job_progress(farm, now, job);
    farm_unlock(farm);
}
