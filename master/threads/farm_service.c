/* farm_service: see farm_service.h. */
#include "master/threads/farm_service.h"

static farm_t *farm_of(void *self)
{
    return ((farm_service_t *)self)->farm;
}

/* ---- control ------------------------------------------------------------------------------------------- */

static result_t hello(void *self, double now, const identity_t *identity, const worker_hello_t *said,
                      uint64_t *worker)
{
    return farm_hello(farm_of(self), now, identity, said, worker);
}

static bool heartbeat(void *self, double now, const identity_t *identity, const heartbeat_t *beat)
{
    bool known = farm_heartbeat(farm_of(self), now, identity, beat->worker, beat->job, beat->units_held);
    if (known && beat->threads > 0) farm_worker_threads(farm_of(self), beat->worker, beat->threads);
    if (known) farm_worker_trouble(farm_of(self), now, beat->worker, beat->trouble);
    return known;
}

static void goodbye(void *self, double now, uint64_t worker, uint64_t job, const char *reason)
{
    farm_goodbye(farm_of(self), now, worker, job, reason);
}

static void claim_units(void *self, double now, const claim_t *claim)
{
    farm_reclaim(farm_of(self), now, claim);
}

static result_t take(void *self, double now, const identity_t *identity, const work_request_t *request,
                     work_t *work)
{
    return farm_take(farm_of(self), now, identity, request->worker, request->job, request->samples,
                     request->unit_samples, work);
}

static bool next_notice(void *self, notice_t *notice)
{
    return farm_next_notice(farm_of(self), notice);
}

static void tick(void *self, double now)
{
    farm_tick(farm_of(self), now);
}

/* ---- batches ------------------------------------------------------------------------------------------- */

static result_t reached(void *self, double now, uint64_t worker)
{
    return farm_worker_reached(farm_of(self), now, worker);
}

static result_t offered(void *self, double now, const batch_offer_t *offer)
{
    (void)now;
    return farm_content_check(farm_of(self), offer->job, offer->named ? &offer->content : NULL);
}

static result_t wanted(void *self, double now, const batch_offer_t *offer)
{
    return farm_batch_wanted(farm_of(self), now, offer->worker, offer->job);
}

static void granted(void *self, double now, uint64_t worker)
{
    farm_batch_granted(farm_of(self), now, worker);
}

/* Once a job: it does not matter that there may be no scene any more. */
static void look_at_lights(farm_service_t *service, farm_batch_t *open)
{
    scene_blob_t blob = {0};
    if (!open->dark) return;
    if (blob_store_peek(service->store, &open->blob, &blob).code == RESULT_OK)
        farm_batch_lights(service->farm, open, &blob);
    blob_close(&blob);
}

static result_t add(void *self, double now, const incoming_batch_t *incoming)
{
    farm_t *farm = farm_of(self);
    batch_t *batch = incoming->batch;
    batch_head_t head = {.worker = incoming->worker,
                         .job = incoming->job,
                         .check = incoming->check,
                         .content = incoming->content,
                         .units = batch->units,
                         .issues = incoming->issues,
                         .unit_count = batch->unit_count,
                         .bytes = incoming->bytes};
    farm_batch_t open;
    result_t result = farm_batch_begin(farm, now, &head, &open);
    if (result.code == RESULT_OK) {
        look_at_lights(self, &open);
        batch->settings = open.settings;
        result = job_check_units(&batch->settings, batch->units, batch->unit_count);
        if (result.code == RESULT_OK)
            result = farm_batch_commit(farm, now, &open, batch, incoming->payload);
        else
            farm_batch_abort(farm, &open, NULL, 0); /* nobody holds what is not of the job */
        if (result.code == RESULT_LIMIT) result.code = RESULT_MISMATCH; /* that is decided */
    }
    /* Who was let send it and is not known any more has lost its units: that is decided. */
    if (result.code == RESULT_UNREACHABLE) result.code = RESULT_CANCELLED;
    return result;
}

/* ---- scenes -------------------------------------------------------------------------------------------- */

static result_t blob_size(void *self, const hash_t *hash, uint64_t *size)
{
    if (blob_store_find(((farm_service_t *)self)->store, hash, size)) return result_ok();
    return farm_plan_size(farm_of(self), hash, size);
}

static result_t blob_read(void *self, const hash_t *hash, uint64_t offset, void *bytes, size_t length)
{
    size_t read = length;
    uint64_t size;
    if (farm_plan_size(farm_of(self), hash, &size).code == RESULT_OK)
        return farm_plan_read(farm_of(self), hash, offset, bytes, length);
    TRY(blob_store_get(((farm_service_t *)self)->store, hash, offset, bytes, &read));
    return read == length ? result_ok() : result_fail(RESULT_IO, "the blob's file is shorter than it was");
}

serve_handler_t farm_service_handler(farm_service_t *service)
{
    static const serve_calls_t calls = {.hello = hello,
                                        .heartbeat = heartbeat,
                                        .goodbye = goodbye,
                                        .claim = claim_units,
                                        .take = take,
                                        .next_notice = next_notice,
                                        .tick = tick,
                                        .reached = reached,
                                        .offered = offered,
                                        .wanted = wanted,
                                        .granted = granted,
                                        .add = add,
                                        .blob_size = blob_size,
                                        .blob_read = blob_read};
    return (serve_handler_t){&calls, service};
}
