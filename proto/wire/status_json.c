/* status_json: see status_json.h. */
#include "proto/wire/status_json.h"

static void put_hash_of(json_t *object, const char *key, const ProtobufCBinaryData *bytes)
{
    hash_t hash;
    put_hash(object, key, wire_hash_get(bytes, &hash) ? &hash : NULL);
}

static void put_settings(json_t *object, const Lm__Settings *message)
{
    job_settings_t settings;
    if (message == NULL || wire_settings_get(message, &settings).code != RESULT_OK) return;
    put_text(object, "integrator", integrator_name(settings.integrator));
    put_text(object, "sampler", sampler_name(settings.sampler));
    put_count(object, "seed", settings.seed);
    put_count(object, "width", (uint64_t)settings.width);
    put_count(object, "height", (uint64_t)settings.height);
    put_count(object, "max_depth", (uint64_t)settings.max_depth);
    put_count(object, "spp", settings.spp);
    put_real(object, "time_limit", settings.time_limit);
    put_real(object, "error_target", settings.error);
    put_flag(object, "adaptive", settings.adaptive);
    json_t *save_at = json_array();
    for (uint32_t i = 0; i < settings.save_at.count; i++)
        json_array_append_new(save_at, json_integer(settings.save_at.spp[i]));
    json_object_set_new(object, "save_at", save_at);
    put_flag(object, "layers", settings.features);
    put_flag(object, "cryptomatte", settings.cryptomatte);
    put_flag(object, "learn", settings.learn);
    put_flag(object, "spectral", settings.spectral);
    put_text(object, "light_groups", settings.light_groups);
    if (settings.integrator == INTEGRATOR_VCM) put_real(object, "merge_radius", settings.merge_radius);
    if (settings.strategy_t == 0) return;
    put_count(object, "strategy_s", (uint64_t)settings.strategy_s);
    put_count(object, "strategy_t", (uint64_t)settings.strategy_t);
    put_flag(object, "unweighted", settings.unweighted);
}

static void put_terms(json_t *object, const Lm__Terms *terms)
{
    if (terms == NULL) return;
    json_object_set_new(object, "priority", json_integer(terms->priority));
    put_real(object, "verify", terms->verify);
    put_flag(object, "mixed", terms->mixed);
    put_flag(object, "halves", terms->halves);
}

static void put_counts(json_t *object, const Lm__Counts *counts)
{
    if (counts == NULL) return;
    put_count(object, "light_paths", counts->light_paths_even + counts->light_paths_odd);
    put_count(object, "dropped", counts->dropped);
    put_count(object, "overflows", counts->overflows);
    put_count(object, "rays", counts->rays);
    put_real(object, "cpu_seconds", 1e-6 * (double)counts->cpu_us);
}

static void put_samples(json_t *object, const Lm__JobStatus *job)
{
    put_count(object, "samples_done", job->samples_done);
    put_count(object, "samples_total", job->samples_total);
    put_count(object, "samples_issued", job->samples_issued);
    put_count(object, "samples_counted", job->samples_counted);
    put_count(object, "samples_returned", job->samples_returned);
    put_count(object, "samples_out", job->samples_out);
    put_count(object, "samples_skipped", job->samples_skipped);
}

json_t *status_json_job(const Lm__JobStatus *job)
{
    json_t *object = json_object();
    put_count(object, "job", job->job);
    put_text(object, "name", job->name);
    put_text(object, "state", job_state_name(job->state));
    put_hash_of(object, "scene", &job->blob);
    put_samples(object, job);
    put_real(object, "elapsed", job->elapsed);
    put_real(object, "remaining", job->remaining);
    put_real(object, "error", job->error);
    put_count(object, "saved", job->saved);
    put_real(object, "checkpoint_age", job->checkpoint_age);
    put_real(object, "submitted", job->submitted);
    put_real(object, "ended", job->ended);
    put_flag(object, "retained", job->retained);
    put_hash_of(object, "fingerprint", &job->fingerprint);
    put_count(object, "workers", job->workers);
    put_count(object, "workers_seen", job->workers_seen);
    put_count(object, "bytes_received", job->bytes_received);
    put_count(object, "batches", job->batches);
    put_count(object, "batches_refused", job->batches_refused);
    put_count(object, "units_reissued", job->units_reissued);
    put_count(object, "checks_passed", job->checks_passed);
    put_count(object, "checks_failed", job->checks_failed);
    put_count(object, "evidence", job->evidence);
    put_count(object, "evidence_limit", job->evidence_limit);
    put_settings(object, job->settings);
    put_terms(object, job->terms);
    put_counts(object, job->counts);
    put_text(object, "message", job->message);
    return object;
}

json_t *status_json_worker(const Lm__WorkerStatus *worker)
{
    json_t *object = json_object();
    put_text(object, "name", worker->name);
    put_text(object, "key", worker->key);
    put_text(object, "address", worker->address);
    put_count(object, "threads", worker->threads);
    put_hash_of(object, "fingerprint", &worker->fingerprint);
    put_flag(object, "relay", worker->relay);
    put_flag(object, "connected", worker->connected);
    put_text(object, "aside", worker->aside);
    put_count(object, "job", worker->job);
    put_count(object, "units_held", worker->units_held);
    put_real(object, "speed", worker->speed);
    put_count(object, "batches", worker->batches);
    put_count(object, "batches_refused", worker->batches_refused);
    put_count(object, "units_reissued", worker->units_reissued);
    put_count(object, "bytes", worker->bytes);
    put_real(object, "last_seen", worker->last_seen);
    return object;
}
