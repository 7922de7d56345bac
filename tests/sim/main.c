/* The command line of the simulator (sim.h). */
#include "tests/sim/sim.h"

#include <getopt.h>
#include <stdlib.h>
#include <string.h>

static const char HELP[] = "sim: a real master and very many simulated workers: what one master can take\n"
                           "\n"
                           "usage: sim [options]      from the top of the tree\n"
                           "\n"
                           "  --workers N            (500)\n"
                           "  --size WIDTHxHEIGHT    of the image (1920x1080)\n"
                           "  --seconds S            how long it is measured (180)\n"
                           "  --interval S           between the batches of a worker (10)\n"
                           "  --power P              of a worker, in cores of this machine (1)\n"
                           "  --row S                between lines of the table (10)\n"
                           "  --relays N             between the workers and the master (0)\n"
                           "  --no-learn             the job does not learn\n"
                           "  --batch-memory MB      the master's memory for batches\n"
                           "  --master OPTIONS       more options for lightmill-master\n"
                           "  --stop-and-go          the master is stopped for a second of every four\n";

static bool set_option(sim_options_t *options, const char *name, const char *value)
{
    if (strcmp(name, "workers") == 0) options->workers = atoi(value);
    if (strcmp(name, "size") == 0) return sscanf(value, "%dx%d", &options->width, &options->height) == 2;
    if (strcmp(name, "seconds") == 0) options->seconds = atof(value);
    if (strcmp(name, "interval") == 0) options->interval = atof(value);
    if (strcmp(name, "power") == 0) options->power = atof(value);
    if (strcmp(name, "row") == 0) options->row = atof(value);
    if (strcmp(name, "relays") == 0) options->relays = atoi(value);
    if (strcmp(name, "no-learn") == 0) options->no_learn = true;
    if (strcmp(name, "batch-memory") == 0) options->batch_megabytes = atoi(value);
    if (strcmp(name, "master") == 0) options->master = value;
    if (strcmp(name, "stop-and-go") == 0) options->pause_merging = true;
    return options->workers > 0 && options->power > 0 && options->interval > 0 && options->row > 0;
}

/* The last lines: what the table comes to. */
static void print_summary(const sim_report_t *r)
{
    printf("%.1f batches/s, %.2f GB/s of raw splat frames, %.0f MB/s on the wire; master %.2f cores, "
           "simulator %.2f\n",
           r->batches, 1e-9 * r->raw, 1e-6 * r->wire, r->master_cpu, r->own_cpu);
    printf("memory of the master: %.0f MB in the first third, %.0f MB in the last, at most %.0f MB\n",
           1e-6 * r->memory_early, 1e-6 * r->memory_late, 1e-6 * r->memory_most);
    if (r->relay_memory > 0)
        printf("relays: %.2f cores in all, %.0f MB at most\n", r->relay_cpu, 1e-6 * r->relay_memory);
    printf("workers that wait: %.1f in the first third, %.1f in the last; a batch every %.1f s\n",
           r->sent_early, r->sent_late, r->interval);
    printf("heartbeats: %.2f ms half, %.1f ms 99 %%, %.0f ms at most\n", 1e3 * r->beat_median,
           1e3 * r->beat_99, 1e3 * r->beat_most);
    printf(
        "samples: %llu by the workers' account, %llu by the master's; refused %llu, lost %llu, failed %llu\n",
        (unsigned long long)r->samples, (unsigned long long)r->samples_counted,
        (unsigned long long)r->all.refused, (unsigned long long)r->all.lost,
        (unsigned long long)r->all.failed);
}

int main(int argc, char **argv)
{
    static const struct option table[] = {{"workers", required_argument, NULL, 0},
                                          {"size", required_argument, NULL, 0},
                                          {"seconds", required_argument, NULL, 0},
                                          {"interval", required_argument, NULL, 0},
                                          {"power", required_argument, NULL, 0},
                                          {"row", required_argument, NULL, 0},
                                          {"relays", required_argument, NULL, 0},
                                          {"batch-memory", required_argument, NULL, 0},
                                          {"master", required_argument, NULL, 0},
                                          {"stop-and-go", no_argument, NULL, 0},
                                          {"no-learn", no_argument, NULL, 0},
                                          {"help", no_argument, NULL, 'h'},
                                          {NULL, 0, NULL, 0}};
    sim_options_t options = sim_options_default();
    int index, choice;
    while ((choice = getopt_long(argc, argv, "h", table, &index)) != -1) {
        bool good = choice == 0 && set_option(&options, table[index].name, optarg);
        if (!good) fputs(HELP, choice == 'h' ? stdout : stderr);
        if (!good) return choice == 'h' ? 0 : 1;
    }
    log_init("sim", LOG_WARNING);
    sim_report_t report;
    result_t result = sim_run(&options, &report);
    if (result.code == RESULT_OK)
        print_summary(&report);
    else
        fprintf(stderr, "sim: %s\n", result.message);
    return result_exit_code(result);
}
