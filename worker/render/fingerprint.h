/* fingerprint: do two machines make the same bits? */
#ifndef LIGHTMILL_FINGERPRINT_H
#define LIGHTMILL_FINGERPRINT_H

#include "common/base.h"

/* Renders a tiny built-in scene and hashes its exact sums, together with the C library's functions at some
 * thousand points. Machines with the same fingerprint render the same bits, as far as that can be told in a
 * few ms; another version of Lightmill has another fingerprint. Thread-safe. */
result_t renderer_fingerprint(hash_t *hash);

#endif
