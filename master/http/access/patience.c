/* patience: see patience.h. */
#include "master/http/access/patience.h"

#include "common/thread.h"

#include <math.h>
#include <pthread.h>
#include <stdlib.h>
#include <sys/socket.h>

struct patient {
    int socket;
    double until; /* INFINITY: it is being answered, or was shut down */
    patient_t *next, **link;
};

struct patience {
    double seconds;
    pthread_t thread;
    pthread_mutex_t lock; /* guards what follows */
    pthread_cond_t changed;
    bool ending;
    patient_t *patients;
};

/* Under the lock. */
static void shut_slow_ones(patience_t *patience, double now)
{
    for (patient_t *patient = patience->patients; patient != NULL; patient = patient->next) {
        if (now < patient->until) continue;
        shutdown(patient->socket, SHUT_RDWR);
        patient->until = INFINITY;
    }
}

/* Waits for a quarter of the time, or, when there is no connection, for the first. Under the lock. */
static void wait_a_while(patience_t *patience)
{
    if (patience->patients == NULL)
        pthread_cond_wait(&patience->changed, &patience->lock);
    else
        cond_wait_until(&patience->changed, &patience->lock, clock_now() + patience->seconds / 4);
}

static void *patience_run(void *context)
{
    patience_t *patience = context;
    pthread_mutex_lock(&patience->lock);
    while (!patience->ending) {
        wait_a_while(patience);
        shut_slow_ones(patience, clock_now());
    }
    pthread_mutex_unlock(&patience->lock);
    return NULL;
}

static void patience_free(patience_t *patience)
{
    pthread_cond_destroy(&patience->changed);
    pthread_mutex_destroy(&patience->lock);
    free(patience);
}

result_t patience_start(double seconds, patience_t **out)
{
    patience_t *patience = mem_zalloc(1, sizeof *patience);
    patience->seconds = seconds;
    pthread_mutex_init(&patience->lock, NULL);
    cond_init_monotonic(&patience->changed);
    result_t result = thread_start(&patience->thread, "lm-patience", patience_run, patience);
    if (result.code == RESULT_OK)
        *out = patience;
    else
        patience_free(patience);
    return result;
}

void patience_stop(patience_t **out)
{
    patience_t *patience = *out;
    if (patience == NULL) return;
    pthread_mutex_lock(&patience->lock);
    patience->ending = true;
    pthread_cond_signal(&patience->changed);
    pthread_mutex_unlock(&patience->lock);
    pthread_join(patience->thread, NULL);
    patience_free(patience);
    *out = NULL;
}

patient_t *patience_begin(patience_t *patience, int socket)
{
    patient_t *patient = mem_zalloc(1, sizeof *patient);
    pthread_mutex_lock(&patience->lock);
    *patient = (patient_t){.socket = socket,
                           .until = clock_now() + patience->seconds,
                           .next = patience->patients,
                           .link = &patience->patients};
    if (patient->next == NULL) pthread_cond_signal(&patience->changed);
    if (patient->next != NULL) patient->next->link = &patient->next;
    patience->patients = patient;
    pthread_mutex_unlock(&patience->lock);
    return patient;
}

void patience_gone(patience_t *patience, patient_t *patient)
{
    if (patient == NULL) return;
    pthread_mutex_lock(&patience->lock);
    *patient->link = patient->next;
    if (patient->next != NULL) patient->next->link = patient->link;
    pthread_mutex_unlock(&patience->lock);
    free(patient);
}

static void set_until(patience_t *patience, patient_t *patient, double until)
{
    if (patient == NULL) return;
    pthread_mutex_lock(&patience->lock);
    patient->until = until;
    pthread_mutex_unlock(&patience->lock);
}

void patience_asked(patience_t *patience, patient_t *patient)
{
    set_until(patience, patient, INFINITY);
}

void patience_answered(patience_t *patience, patient_t *patient)
{
    set_until(patience, patient, clock_now() + patience->seconds);
}
