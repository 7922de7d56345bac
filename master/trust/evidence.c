/* evidence: all that was merged into verified jobs, kept until they are over, so that it can be taken out of
 * the film again (checks.c says when).
 *
 * DESIGN. The batches are on the disk, as they came (spool.h), not in memory; there is a line for each. All
 * disk work is done by merging threads, in trust_keep_write, and by the checkpointer's, in trust_settle,
 * which also takes out what is wrong: exact sums can be subtracted.
 *
 * The evidence has to tell the truth about the film after a kill of the master, too: a batch that is taken
 * out twice, or not at all, spoils the image. The film comes back as its last checkpoint has it, so the
 * question for every batch on the disk is whether that checkpoint has it. To tell, events are ordered by a
 * clock that is saved with the film anyway: 2 * returned + counted + issued of the schedule's account.
 * Whatever happens to a sample makes it larger: being issued by 1, counted by 1 (or 2, when nobody held it),
 * given back by 1 at least, being taken out of the film by 1. A batch has the clock at which it was in the
 * film, one that was taken out also the clock at which it was not any more. Both are noted inside the shared
 * film, so no snapshot comes in between. A film whose state has clock s holds the batches with clock <= s,
 * but for those that were out by then. So when a film is loaded, batches from after its snapshot are deleted,
 * and those that were taken out after it are taken out once more.
 *
 * A batch that was taken out stays until two later checkpoints are safe, since the older one is used when the
 * newer is damaged. Before a checkpoint counts, the spool is written out (farm_sync).
 *
 * Which batches are being compared is in their names; comparisons begin anew after a restart. The evidence of
 * all jobs together has a quota (farm_options_t.evidence_limit). A batch that cannot be kept, for that or
 * since the disk is full, cannot be taken out later: the job's message says so. It is compared as others are.
 * The same holds for a job that has all its samples and is only being written down when a sender is found
 * out. One that is cut short waits until what is known to be wrong is out of its film. */
#include "master/trust/trust_state.h"

#include <stdlib.h>
#include <string.h>

uint64_t evidence_clock(const schedule_account_t *account)
{
    return 2 * account->returned + account->counted + account->issued;
}

evidence_t *evidence_find(const job_checks_t *checks, uint64_t serial)
{
    for (size_t i = 0; checks != NULL && i < checks->evidence_count; i++)
        if (checks->evidence[i].name.serial == serial) return &checks->evidence[i];
    return NULL;
}

static void add(job_checks_t *checks, evidence_t evidence)
{
    checks->evidence = mem_realloc(checks->evidence, (checks->evidence_count + 1) * sizeof evidence);
    checks->evidence[checks->evidence_count++] = evidence;
    checks->bytes += evidence.name.bytes;
}

/* ---- a batch was merged -------------------------------------------------------------------------------- */

struct trust_keep {
    evidence_t evidence;
    spool_head_t head;
    uint64_t worker; /* the sender */
    sample_t sample;
    result_t written, digested;
};

trust_keep_t *trust_keep_begin(farm_t *farm, job_t *job, const worker_t *worker, const batch_t *batch)
{
    if (worker == NULL || job->kept.terms.verify <= 0 || farm->options.spool_dir == NULL) return NULL;
    job_checks_t *checks = checks_of(job);
    if (checks->given_up) return NULL;
    trust_keep_t *keep = mem_zalloc(1, sizeof *keep);
    schedule_account_t account = schedule_account(job->schedule);
    keep->evidence = (evidence_t){
        .name = {.clock = evidence_clock(&account), .serial = ++checks->last_serial, .kind = SPOOL_CHECK},
        .kind = SPOOL_CHECK,
        .source = checks_source(checks, worker)};
    keep->sample = checks_sample(farm, job, worker->party, batch->units, batch->unit_count);
    keep->worker = worker->id;
    keep->head = (spool_head_t){.fingerprint = worker->fingerprint,
                                .counts = batch->counts,
                                .units = batch->units,
                                .unit_count = batch->unit_count};
    memcpy(keep->head.name, worker->name, sizeof keep->head.name);
    memcpy(keep->head.party, worker->party_text, sizeof keep->head.party);
    return keep;
}

/* Room for so many bytes more in all evidence. */
static result_t check_room(farm_t *farm, uint64_t bytes)
{
    uint64_t used = 0;
    farm_lock(farm);
    for (size_t i = 0; i < farm->job_count; i++) used += trust_evidence(farm->jobs[i]);
    farm_unlock(farm);
    if (used + bytes <= farm->options.evidence_limit) return result_ok();
    return result_fail(RESULT_LIMIT, "the evidence of all jobs takes %.1f GB of %.1f GB already",
                       1e-9 * (double)used, 1e-9 * (double)farm->options.evidence_limit);
}

void trust_keep_write(farm_t *farm, const job_t *job, trust_keep_t *keep, const batch_t *batch,
                      const zmq_msg_t payload[BATCH_PAYLOADS])
{
    spool_name_t *name = &keep->evidence.name;
    name->bytes = spool_size(&keep->head, payload);
    keep->written = check_room(farm, name->bytes);
    if (keep->written.code == RESULT_OK)
        keep->written = spool_write(farm->options.spool_dir, job->kept.job, name, &keep->head, payload);
    keep->digested = checks_digest(payload, batch, &keep->sample);
}

/* The batch is in the film, but not on the disk. */
static void note_unkept(farm_t *farm, job_t *job, const trust_keep_t *keep)
{
    job_checks_t *checks = job->checks;
    checks->sources[keep->evidence.source].unkept++;
    if (checks->unkept++ > 0) return;
    log_error("job %llu: a batch of %s is not kept: %s", (unsigned long long)job->kept.job, keep->head.name,
              keep->written.message);
    farm_job_tell(farm, job, "batches cannot be taken out again, since they are not kept: %.160s",
                  keep->written.message);
}

/* The batch was merged: it goes on the list, and is compared. */
static void keep_it(farm_t *farm, job_t *job, trust_keep_t *keep)
{
    job_checks_t *checks = job->checks;
    evidence_t *evidence = &keep->evidence;
    bool kept = keep->written.code == RESULT_OK;
    const worker_t *worker = farm_find_worker(farm, keep->worker);
    bool condemned = worker != NULL && worker->outcast; /* it was found out meanwhile */
    if (!kept) note_unkept(farm, job, keep);
    if (keep->digested.code != RESULT_OK) evidence->kind = SPOOL_KEPT;
    if (condemned) evidence->kind = SPOOL_WRONG;
    if (kept) add(checks, *evidence);
    if (condemned) wake_up(farm->options.checkpoint_wake);
    if (evidence->kind == SPOOL_CHECK)
        checks_want(farm, job, &keep->sample, kept ? evidence->name.serial : 0, evidence->source,
                    &keep->head.fingerprint);
}

void trust_keep_end(farm_t *farm, job_t *job, trust_keep_t **pointer, bool merged)
{
    trust_keep_t *keep = *pointer;
    if (merged) keep_it(farm, job, keep);
    free(keep->sample.units);
    free(keep);
    *pointer = NULL;
}

/* ---- verdicts ------------------------------------------------------------------------------------------ */

bool trust_wrong(const job_t *job)
{
    const job_checks_t *checks = job->checks;
    for (size_t i = 0; checks != NULL && i < checks->evidence_count; i++)
        if (checks->evidence[i].kind == SPOOL_WRONG) return true;
    return false;
}

uint64_t trust_evidence(const job_t *job)
{
    return job->checks != NULL ? job->checks->bytes : 0;
}

bool trust_delayed(const job_t *job)
{
    return job->checks != NULL && job->checks->delayed && trust_wrong(job);
}

/* What a source has in the film of a job is to be taken out. Returns how many files of evidence. */
static uint32_t brand(job_checks_t *checks, size_t source)
{
    uint32_t count = 0;
    for (size_t i = 0; i < checks->evidence_count; i++) {
        evidence_t *evidence = &checks->evidence[i];
        if (evidence->source != source || evidence->kind >= SPOOL_WRONG) continue;
        evidence->kind = SPOOL_WRONG;
        count++;
    }
    return count;
}

/* Takes out what a process delivered to a job, unless that ends: nobody would render it again. */
static void withdraw(farm_t *farm, job_t *job, size_t index)
{
    job_checks_t *checks = job->checks;
    source_t *source = &checks->sources[index];
    bool ends = job_has_film(job) && job->film != FILM_OPEN;
    uint32_t out = ends ? 0 : brand(checks, index);
    checks_forget(job, index);
    log_warning("job %llu: %u batches of %s are taken out of the film", (unsigned long long)job->kept.job,
                out, source->name);
    wake_up(farm->options.checkpoint_wake);
    if (!ends && source->unkept == 0) return;
    log_error("job %llu: batches of %s stay in the film, since %s", (unsigned long long)job->kept.job,
              source->name, ends ? "the job has ended" : "they were not kept");
    farm_job_tell(farm, job, "batches of %.60s, with wrong sums, are in the image: render it again",
                  source->name);
    source->unkept = 0;
}

void evidence_condemn(farm_t *farm, uint64_t who)
{
    for (size_t j = 0; j < farm->job_count; j++) {
        const job_checks_t *checks = farm->jobs[j]->checks;
        for (size_t i = 0; checks != NULL && i < checks->source_count; i++)
            if (checks->sources[i].id == who || checks->sources[i].party == who)
                withdraw(farm, farm->jobs[j], i);
    }
}

/* True when somebody means this process by a key, an address or a name. */
static bool is_meant(const source_t *source, const char *who)
{
    const char *space = strchr(source->party_text, ' '); /* "key ...", "address ..." */
    return strcmp(source->name, who) == 0 || strcmp(source->party_text, who) == 0 ||
           (space != NULL && strcmp(space + 1, who) == 0);
}

result_t trust_take_out(farm_t *farm, job_t *job, const char *who)
{
    const job_checks_t *checks = job->checks;
    size_t found = 0;
    for (size_t i = 0; checks != NULL && i < checks->source_count; i++) {
        if (!is_meant(&checks->sources[i], who)) continue;
        withdraw(farm, job, i);
        found++;
    }
    if (found > 0) return result_ok();
    return result_fail(RESULT_INPUT,
                       "job %llu has nothing of %s: say a key, an address, or the name of a worker, as "
                       "lightmill status --workers shows them",
                       (unsigned long long)job->kept.job, who);
}

/* ---- checkpoints, and coming back ---------------------------------------------------------------------- */

void trust_checkpointed(job_t *job)
{
    if (job->checks != NULL) job->checks->saved++;
}

static uint64_t clock_of_state(const job_settings_t *settings, const schedule_state_t *state)
{
    schedule_account_t account = {.issued = state->issued,
                                  .counted = schedule_state_samples(settings, state),
                                  .returned = state->returned};
    return evidence_clock(&account);
}

/* What a batch on the disk is to a film with this clock; false when the film never had it. */
static bool state_of(const spool_name_t *name, uint64_t clock, evidence_t *evidence)
{
    *evidence = (evidence_t){.name = *name, .kind = name->kind};
    if (name->kind == SPOOL_OUT && name->out_clock > clock) evidence->kind = SPOOL_WRONG;
    return name->clock <= clock;
}

/* The sender of a batch from an earlier life of the master. */
static worker_t sender_of(const spool_head_t *head)
{
    worker_t sender = {.id = 0};
    memcpy(sender.name, head->name, sizeof sender.name);
    if (strchr(head->party, ' ') != NULL)
        memcpy(sender.party_text, head->party, sizeof sender.party_text);
    else
        snprintf(sender.key, sizeof sender.key, "%.*s", WIRE_KEY_TEXT, head->party);
    standing_identify(&sender);
    return sender;
}

/* True when the film has the samples of a batch, and no other one had them: takes them from a copy of its
 * schedule. */
static bool take_samples(schedule_t *schedule, const job_t *job, const spool_head_t *head)
{
    uint64_t before = schedule_done(schedule);
    schedule_uncount(schedule, head->units, head->unit_count);
    double taken = (double)(before - schedule_done(schedule));
    return taken >= farm_unit_samples(job, head->units, head->unit_count);
}

/* Reads a batch that the film has, and puts it on the list. What is to be compared of one that was not
 * compared yet is chosen anew. */
static result_t load_one(farm_t *farm, job_t *job, const job_settings_t *settings, evidence_t *evidence,
                         schedule_t *schedule)
{
    const char *dir = farm->options.spool_dir;
    spool_head_t head;
    zmq_msg_t payload[BATCH_PAYLOADS];
    spool_name_t from = evidence->name;
    evidence->name.kind = evidence->kind; /* what was out may be wrong again */
    if (from.kind != evidence->kind) TRY(spool_rename(dir, job->kept.job, &from, &evidence->name));
    bool compared = evidence->kind == SPOOL_CHECK;
    TRY(compared ? spool_read(dir, job->kept.job, &evidence->name, settings, &head, payload)
                 : spool_read_head(dir, job->kept.job, &evidence->name, settings, &head));
    worker_t sender = sender_of(&head);
    batch_t batch = {
        .settings = *settings, .units = head.units, .unit_count = head.unit_count, .counts = head.counts};
    result_t result = result_ok();
    sample_t sample = {.units = NULL};
    farm_lock(farm);
    if (compared) sample = checks_sample(farm, job, sender.party, head.units, head.unit_count);
    farm_unlock(farm);
    if (evidence->kind != SPOOL_OUT && !take_samples(schedule, job, &head)) {
        /* It would be taken for evidence when others have rendered them again. */
        spool_delete(dir, job->kept.job, &evidence->name);
        result = result_fail(RESULT_INPUT, "the film does not have its samples");
    } else if (compared) {
        result = checks_digest(payload, &batch, &sample);
    }
    farm_lock(farm);
    evidence->source = checks_source(checks_of(job), &sender);
    if (result.code == RESULT_OK) add(job->checks, *evidence);
    if (result.code == RESULT_OK && compared)
        checks_want(farm, job, &sample, evidence->name.serial, evidence->source, &head.fingerprint);
    farm_unlock(farm);
    for (int i = 0; compared && i < BATCH_PAYLOADS; i++) zmq_msg_close(&payload[i]);
    free(sample.units);
    spool_head_free(&head);
    return result;
}

/* The schedule that the job will go on with; NULL when it begins anew. */
static schedule_t *restored(const job_settings_t *settings, const schedule_state_t *state)
{
    schedule_t *schedule = NULL;
    job_settings_t copy = *settings;
    if (state != NULL) (void)schedule_restore(&copy, state, &schedule);
    return schedule;
}

void trust_loaded(farm_t *farm, job_t *job, const schedule_state_t *state)
{
    const char *dir = farm->options.spool_dir;
    if (dir == NULL) return;
    size_t count, kept = 0, wrong = 0;
    spool_name_t *names = spool_list(dir, job->kept.job, &count);
    job_settings_t settings = farm_job_settings(farm, job);
    schedule_t *schedule = count > 0 && job->kept.terms.verify > 0 ? restored(&settings, state) : NULL;
    uint64_t clock = schedule != NULL ? clock_of_state(&settings, state) : 0;
    for (size_t i = 0; i < count; i++) {
        evidence_t evidence;
        if (schedule == NULL || !state_of(&names[i], clock, &evidence)) {
            spool_delete(dir, job->kept.job, &names[i]);
            continue;
        }
        result_t result = load_one(farm, job, &settings, &evidence, schedule);
        kept += result.code == RESULT_OK;
        wrong += evidence.kind == SPOOL_WRONG;
        if (result.code != RESULT_OK)
            log_error("job %llu: a batch cannot be taken out any more: %s", (unsigned long long)job->kept.job,
                      result.message);
        farm_lock(farm);
        if (checks_of(job)->last_serial < names[i].serial) job->checks->last_serial = names[i].serial;
        farm_unlock(farm);
    }
    free(names);
    if (schedule != NULL) schedule_destroy(&schedule);
    if (count == 0) return;
    log_info("job %llu: %zu batches in its film can be taken out, %zu are to be",
             (unsigned long long)job->kept.job, kept, wrong);
}
