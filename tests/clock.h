/* clock: CPU time, for tests and benches. */
#ifndef LIGHTMILL_CLOCK_H
#define LIGHTMILL_CLOCK_H

/* CPU seconds (user and system) that this process has used so far. */
double clock_cpu(void);

#endif
