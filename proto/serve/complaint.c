/* complaint: see complaint.h. */
#include "proto/serve/complaint.h"

enum { WINDOW = 10, MOST = 5 }; /* seconds; warnings in them */

bool complaint_allowed(complaint_t *complaint, double now)
{
    if (complaint->window == 0 || now - complaint->window > WINDOW) {
        if (complaint->count > MOST)
            log_warning("%u more warnings like these were left out", complaint->count - MOST);
        complaint->window = now;
        complaint->count = 0;
    }
    return complaint->count++ < MOST;
}
