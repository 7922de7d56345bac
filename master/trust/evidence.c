/* evidence: batches of verified jobs that were merged, kept until their senders are vouched for, so that
 * they can be taken out of the film again (checks.c says when).
 *
 * DESIGN. The batches are on the disk, as they came (spool.h), not in memory: a worker is vouched for every
 * 1 / verify batches or so. What is in memory is a line for each. All disk work is done by merging threads,
 * in trust_keep_write, and by the checkpointer's, in trust_settle, which also takes out what is wrong:
 * exact sums can be subtracted.
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
 * A source that is gone is not compared any more, but for what is being compared already: what it has left
 * can neither be vouched for nor be found wrong. GONE_SECONDS later it goes, or else a farm of machines that
 * come and go would fill the disk.
 *
 * A batch that was taken out stays until two later checkpoints are safe, since the older one is used when the
 * newer is damaged. Before a checkpoint counts, the spool is written out (farm_sync).
 *
 * Which batches are being compared is in their names; comparisons begin anew after a restart. Vouching is not
 * noted on the disk, deletion of the evidence is. When a batch cannot be written, it cannot be taken out
 * later: the log says so, and if its sender turns out to be wrong, so does the job's message. The same holds
 * for a job that has all its samples and is only being written down when its sender is found out. One that is
 * cut short waits until what is known to be wrong is out of its film. */
#include "master/trust/trust_state.h"

#include <sodium.h>
#include <stdlib.h>
#include <string.h>

enum {
    MUST_CHECK = 2,      /* over verify: batches of a source after which one is compared for certain, */
    MUST_DROP = 4,       /* and after which nobody is waited for who might compare it one day */
    GONE_SECONDS = 3600, /* after which a source that is not connected will not come back */
    GONE_EVERY = 60      /* seconds between looks at who is gone */
};

uint64_t evidence_clock(const schedule_account_t *account)
{
    return 2 * account->returned + account->counted + account->issued;
}

evidence_t *evidence_find(const job_checks_t *checks, uint64_t serial)
{
    for (size_t i = 0; checks != NULL && i < checks->evidence_count; i++)
        if (checks->evidence[i].serial == serial) return &checks->evidence[i];
    return NULL;
}

spool_name_t evidence_name(const evidence_t *evidence)
{
    spool_name_t name = {
        .clock = evidence->clock, .serial = evidence->serial, .out_clock = evidence->out_clock};
    name.kind = evidence->state == EVIDENCE_OUT ? SPOOL_OUT
                : evidence->branded             ? SPOOL_WRONG
                : evidence->checked             ? SPOOL_CHECK
                                                : SPOOL_KEPT;
    return name;
}

static void add(job_checks_t *checks, evidence_t evidence)
{
    checks->evidence = mem_realloc(checks->evidence, (checks->evidence_count + 1) * sizeof evidence);
    checks->evidence[checks->evidence_count++] = evidence;
    if (evidence.state == EVIDENCE_KEPT) checks->sources[evidence.source].unvouched++;
}

/* ---- a batch was merged -------------------------------------------------------------------------------- */

/* Whether the batch is compared: by chance, or because it must be. */
static bool is_chosen(const job_t *job, size_t source)
{
    uint32_t unvouched = job->checks->sources[source].unvouched + 1;
    if (unvouched >= MUST_CHECK / job->kept.terms.verify && !checks_open(job->checks, source)) return true;
    return (double)randombytes_random() < job->kept.terms.verify * 0x1p32;
}

struct trust_keep {
    evidence_t evidence;
    spool_head_t head;
    double joined; /* of the sender, seconds */
    bool begun;    /* it was handed out to be compared */
    result_t written;
    hash_t digest; /* of one that is compared */
};

trust_keep_t *trust_keep_begin(farm_t *farm, job_t *job, const worker_t *worker, const batch_t *batch)
{
    if (worker == NULL || job->kept.terms.verify <= 0 || farm->options.spool_dir == NULL) return NULL;
    job_checks_t *checks = checks_of(job);
    if (checks->given_up) return NULL;
    trust_keep_t *keep = mem_zalloc(1, sizeof *keep);
    schedule_account_t account = schedule_account(job->schedule);
    size_t source = checks_source(checks, worker->source, worker->party, worker->name, worker->party_text);
    keep->evidence =
        (evidence_t){.clock = evidence_clock(&account), .serial = ++checks->last_serial, .source = source};
    keep->begun = checks_begun(checks, source, batch->units, batch->unit_count) != NULL;
    keep->evidence.checked = keep->begun || (!worker->relay && is_chosen(job, source));
    keep->joined = worker->joined;
    keep->head = (spool_head_t){.fingerprint = worker->fingerprint,
                                .counts = batch->counts,
                                .units = batch->units,
                                .unit_count = batch->unit_count};
    memcpy(keep->head.name, worker->name, sizeof keep->head.name);
    memcpy(keep->head.party, worker->party_text, sizeof keep->head.party);
    return keep;
}

void trust_keep_write(farm_t *farm, const job_t *job, trust_keep_t *keep, const batch_t *batch,
                      const zmq_msg_t payload[BATCH_PAYLOADS])
{
    spool_name_t name = evidence_name(&keep->evidence);
    keep->written = spool_write(farm->options.spool_dir, job->kept.job, &name, &keep->head, payload);
    if (keep->written.code == RESULT_OK && keep->evidence.checked)
        keep->written = payload_digest(payload, batch, &keep->digest);
}

/* The batch is on the disk. */
static void keep_it(farm_t *farm, job_t *job, const batch_t *batch, trust_keep_t *keep)
{
    job_checks_t *checks = job->checks;
    evidence_t *evidence = &keep->evidence;
    const source_t *source = &checks->sources[evidence->source];
    farm->trust->spooled = true;
    if (source->condemned >= keep->joined) { /* found out meanwhile */
        evidence->state = EVIDENCE_WRONG;
        wake_up(farm->options.checkpoint_wake);
    }
    add(checks, *evidence);
    if (!evidence->checked || evidence->state == EVIDENCE_WRONG) return;
    check_t *check =
        keep->begun ? checks_begun(checks, evidence->source, batch->units, batch->unit_count) : NULL;
    if (check != NULL) {
        check->evidence = evidence->serial;
        check->clock = evidence->clock;
    } else if (!keep->begun) {
        checks_want(farm, job, evidence, batch->units, batch->unit_count, &keep->head.fingerprint,
                    &keep->digest);
    }
}

void trust_keep_end(farm_t *farm, job_t *job, trust_keep_t **pointer, const batch_t *batch, bool merged)
{
    trust_keep_t *keep = *pointer;
    if (merged && keep->written.code == RESULT_OK) {
        keep_it(farm, job, batch, keep);
    } else if (merged) {
        job->checks->sources[keep->evidence.source].unkept++;
        log_error("job %llu: a batch of %s cannot be kept until it is vouched for: %s",
                  (unsigned long long)job->kept.job, keep->head.name, keep->written.message);
    }
    free(keep);
    *pointer = NULL;
}

/* ---- verdicts ------------------------------------------------------------------------------------------ */

bool trust_wrong(const job_t *job)
{
    const job_checks_t *checks = job->checks;
    for (size_t i = 0; checks != NULL && i < checks->evidence_count; i++)
        if (checks->evidence[i].state == EVIDENCE_WRONG) return true;
    return false;
}

bool trust_delayed(const job_t *job)
{
    return job->checks != NULL && job->checks->delayed && trust_wrong(job);
}

/* True while a batch is being compared: its own comparison decides about it, though a later one may be over.
 */
static bool is_compared(const job_checks_t *checks, const evidence_t *evidence)
{
    for (size_t i = 0; evidence->checked && i < checks->check_count; i++)
        if (checks->checks[i].evidence == evidence->serial) return true;
    return false;
}

void evidence_vouch(farm_t *farm, job_t *job, size_t source, uint64_t clock)
{
    job_checks_t *checks = job->checks;
    for (size_t i = 0; i < checks->evidence_count; i++) {
        evidence_t *evidence = &checks->evidence[i];
        if (evidence->source != source || evidence->state != EVIDENCE_KEPT || evidence->clock > clock ||
            is_compared(checks, evidence))
            continue;
        evidence->state = EVIDENCE_NEEDLESS;
        checks->sources[source].unvouched--;
    }
    wake_up(farm->options.checkpoint_wake);
}

static bool is_connected(const farm_t *farm, uint64_t source)
{
    for (size_t i = 0; i < farm->worker_count; i++)
        if (farm->workers[i].connected && farm->workers[i].source == source) return true;
    return false;
}

bool evidence_piles_up(const farm_t *farm, const job_t *job, size_t index)
{
    const source_t *source = &job->checks->sources[index];
    return source->unvouched >= MUST_DROP / job->kept.terms.verify && is_connected(farm, source->id);
}

static void let_gone_go(farm_t *farm, double now, job_t *job)
{
    job_checks_t *checks = job->checks;
    for (size_t i = 0; i < farm->worker_count; i++) {
        size_t source = id_table_find(&checks->by_id, farm->workers[i].source);
        if (farm->workers[i].connected && source != SIZE_MAX) checks->sources[source].seen = now;
    }
    for (size_t i = 0; i < checks->source_count; i++) {
        source_t *source = &checks->sources[i];
        if (source->unvouched == 0) continue;
        if (source->seen <= 0 || checks_open(checks, i)) source->seen = now;
        if (now - source->seen < GONE_SECONDS) continue;
        log_info("job %llu: %u batches of %s are kept no longer: it is gone",
                 (unsigned long long)job->kept.job, source->unvouched, source->name);
        evidence_vouch(farm, job, i, UINT64_MAX);
    }
}

void evidence_tick(farm_t *farm, double now)
{
    if (now - farm->trust->gone_looked < GONE_EVERY) return;
    farm->trust->gone_looked = now;
    for (size_t i = 0; i < farm->job_count; i++)
        if (farm->jobs[i]->checks != NULL) let_gone_go(farm, now, farm->jobs[i]);
}

static void condemn(farm_t *farm, double now, job_t *job, size_t index)
{
    job_checks_t *checks = job->checks;
    source_t *source = &checks->sources[index];
    bool ends = job_has_film(job) && job->film != FILM_OPEN; /* nobody would render it again */
    uint32_t out = 0, stay = source->unkept;
    for (size_t i = 0; i < checks->evidence_count; i++) {
        evidence_t *evidence = &checks->evidence[i];
        if (evidence->source != index || evidence->state != EVIDENCE_KEPT) continue;
        if (!ends) evidence->state = EVIDENCE_WRONG;
        stay += ends;
        out += !ends;
    }
    checks_forget(job, index);
    source->condemned = now;
    source->unvouched = 0;
    log_error("job %llu: %u batches of %s are taken out of the film", (unsigned long long)job->kept.job, out,
              source->name);
    if (stay == 0) return;
    log_error("job %llu: %u batches of %s stay in the film, since %s", (unsigned long long)job->kept.job,
              stay, source->name, ends ? "the job has ended" : "they could not be written to the disk");
    farm_job_tell(farm, job, "%u batches of %.60s, which sent wrong sums, are in the image: render it again",
                  stay, source->name);
}

void evidence_condemn(farm_t *farm, double now, uint64_t id)
{
    for (size_t j = 0; j < farm->job_count; j++) {
        job_checks_t *checks = farm->jobs[j]->checks;
        size_t source = checks != NULL ? id_table_find(&checks->by_id, id) : SIZE_MAX;
        if (source != SIZE_MAX) condemn(farm, now, farm->jobs[j], source);
    }
    wake_up(farm->options.checkpoint_wake);
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

/* True when all samples of a unit are counted. */
static bool is_counted(const schedule_state_t *state, const unit_t *unit)
{
    size_t low = 0, high = state->counted_count;
    while (low < high) { /* the first range that does not end before the unit */
        size_t middle = low + (high - low) / 2;
        const unit_t *range = &state->counted[middle];
        if (range->tile > unit->tile ||
            (range->tile == unit->tile && range->first + range->count >= unit->first + unit->count))
            high = middle;
        else
            low = middle + 1;
    }
    return low < state->counted_count && state->counted[low].tile == unit->tile &&
           state->counted[low].first <= unit->first;
}

/* What a batch on the disk is to a film with this clock; false when the film never had it. */
static bool state_of(const spool_name_t *name, uint64_t clock, evidence_t *evidence)
{
    *evidence = (evidence_t){.clock = name->clock, .serial = name->serial, .out_clock = name->out_clock};
    if (name->clock > clock) return false;
    evidence->checked = name->kind == SPOOL_CHECK;
    evidence->branded = name->kind == SPOOL_WRONG;
    evidence->state = evidence->branded ? EVIDENCE_WRONG : EVIDENCE_KEPT;
    if (name->kind == SPOOL_OUT) evidence->state = name->out_clock <= clock ? EVIDENCE_OUT : EVIDENCE_WRONG;
    return true;
}

/* Reads a batch that the film has, and puts it on the list. */
static result_t load_one(farm_t *farm, job_t *job, const job_settings_t *settings, const spool_name_t *name,
                         evidence_t *evidence, const schedule_state_t *state)
{
    const char *dir = farm->options.spool_dir;
    spool_head_t head;
    zmq_msg_t payload[BATCH_PAYLOADS];
    hash_t digest;
    if (name->kind == SPOOL_OUT && evidence->state == EVIDENCE_WRONG) {
        evidence->branded = true;
        spool_name_t wrong = evidence_name(evidence);
        TRY(spool_rename(dir, job->kept.job, name, &wrong));
        TRY(spool_read_head(dir, job->kept.job, &wrong, settings, &head));
    } else if (evidence->checked) {
        TRY(spool_read(dir, job->kept.job, name, settings, &head, payload));
        batch_t batch = {
            .settings = *settings, .units = head.units, .unit_count = head.unit_count, .counts = head.counts};
        result_t result = payload_digest(payload, &batch, &digest);
        for (int i = 0; i < BATCH_PAYLOADS; i++) zmq_msg_close(&payload[i]);
        if (result.code != RESULT_OK) {
            spool_head_free(&head);
            return result;
        }
    } else {
        TRY(spool_read_head(dir, job->kept.job, name, settings, &head));
    }
    worker_t sender = {.id = 0};
    memcpy(sender.name, head.name, sizeof sender.name);
    if (strchr(head.party, ' ') != NULL)
        memcpy(sender.party_text, head.party, sizeof sender.party_text);
    else
        snprintf(sender.key, sizeof sender.key, "%.*s", WIRE_KEY_TEXT, head.party);
    standing_identify(&sender);
    bool counted = true;
    for (size_t i = 0; i < head.unit_count && evidence->state != EVIDENCE_OUT; i++)
        counted = counted && is_counted(state, &head.units[i]);
    farm_lock(farm);
    job_checks_t *checks = checks_of(job);
    evidence->source = checks_source(checks, sender.source, sender.party, sender.name, sender.party_text);
    if (counted) add(checks, *evidence);
    if (counted && evidence->checked)
        checks_want(farm, job, evidence, head.units, head.unit_count, &head.fingerprint, &digest);
    farm_unlock(farm);
    spool_head_free(&head);
    if (counted) return result_ok();
    spool_name_t now = evidence_name(evidence);
    /* It would be taken for evidence when others have rendered them again. */
    spool_delete(dir, job->kept.job, &now);
    return result_fail(RESULT_INPUT, "the film does not have its samples");
}

/* True when the job will go on with this state. */
static bool fits(const job_settings_t *settings, const schedule_state_t *state)
{
    schedule_t *schedule = NULL;
    job_settings_t copy = *settings;
    if (state == NULL || schedule_restore(&copy, state, &schedule).code != RESULT_OK) return false;
    schedule_destroy(&schedule);
    return true;
}

void trust_loaded(farm_t *farm, job_t *job, const schedule_state_t *state)
{
    const char *dir = farm->options.spool_dir;
    if (dir == NULL) return;
    size_t count, kept = 0, wrong = 0;
    spool_name_t *names = spool_list(dir, job->kept.job, &count);
    job_settings_t settings = farm_job_settings(farm, job);
    bool usable = count > 0 && job->kept.terms.verify > 0 && fits(&settings, state);
    uint64_t clock = usable ? clock_of_state(&settings, state) : 0;
    for (size_t i = 0; i < count; i++) {
        evidence_t evidence;
        if (!usable || !state_of(&names[i], clock, &evidence)) {
            spool_delete(dir, job->kept.job, &names[i]);
            continue;
        }
        result_t result = load_one(farm, job, &settings, &names[i], &evidence, state);
        kept += result.code == RESULT_OK;
        wrong += evidence.state == EVIDENCE_WRONG;
        if (result.code != RESULT_OK)
            log_error("job %llu: a batch cannot be vouched for or taken out any more: %s",
                      (unsigned long long)job->kept.job, result.message);
        farm_lock(farm);
        if (checks_of(job)->last_serial < names[i].serial) job->checks->last_serial = names[i].serial;
        farm_unlock(farm);
    }
    free(names);
    if (count == 0) return;
    farm_lock(farm);
    farm->trust->spooled = true; /* what was deleted must not come back after the next checkpoint */
    farm_unlock(farm);
    log_info("job %llu: %zu batches in its film wait to be vouched for, %zu are to be taken out",
             (unsigned long long)job->kept.job, kept, wrong);
}
