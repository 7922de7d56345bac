/* network: see network.h. */
#include "tests/chaos/network.h"

#include "tests/chaos/process.h"

#include <errno.h>
#include <fcntl.h>
#include <net/if.h>
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/mount.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <unistd.h>

typedef struct {
    pid_t holder; /* keeps the namespace alive */
    int file;
    char device[16]; /* our end of the cable */
    network_way_t cut;
    bool thin;
} site_t;

struct network {
    site_t sites[NETWORK_MAX_SITES];
    size_t count;
};

#define COMMAND(...) ((const char *[]){__VA_ARGS__, NULL})

/* ---- separation --------------------------------------------------------------------------------------- */

static bool write_text(const char *path, const char *text)
{
    int file = open(path, O_WRONLY | O_CLOEXEC);
    bool written = file >= 0 && write(file, text, strlen(text)) == (ssize_t)strlen(text);
    if (file >= 0) close(file);
    return written;
}

static void stuck(const char *what)
{
    fprintf(stderr, "chaos: in a network of its own, and stuck there: %s: %s\n", what, strerror(errno));
    exit(RESULT_IO);
}

static bool separate_as_user(void)
{
    char users[60], groups[60];
    snprintf(users, sizeof users, "0 %u 1", geteuid());
    snprintf(groups, sizeof groups, "0 %u 1", getegid());
    if (unshare(CLONE_NEWUSER | CLONE_NEWNET | CLONE_NEWNS) != 0) return false;
    if (!write_text("/proc/self/uid_map", users) || !write_text("/proc/self/setgroups", "deny") ||
        !write_text("/proc/self/gid_map", groups))
        stuck("its users");
    return true;
}

static bool raise_loopback(void)
{
    struct ifreq request = {.ifr_name = "lo", .ifr_flags = IFF_UP | IFF_RUNNING};
    int file = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    bool raised = ioctl(file, SIOCSIFFLAGS, &request) == 0;
    close(file);
    return raised;
}

result_t network_separate(void)
{
    bool separate = unshare(CLONE_NEWNET | CLONE_NEWNS) == 0 || separate_as_user();
    if (!separate) return result_fail(RESULT_MISMATCH, "no network of its own: %s", strerror(errno));
    if (mount("none", "/", NULL, MS_REC | MS_PRIVATE, NULL) != 0) stuck("its mounts");
    if (!raise_loopback()) stuck("its loopback");
    return result_ok();
}

/* ---- sites -------------------------------------------------------------------------------------------- */

/* A process in a network of its own that waits for its end. */
static result_t hold_namespace(site_t *site)
{
    int ready[2];
    if (pipe2(ready, O_CLOEXEC) != 0 || (site->holder = fork()) < 0)
        return result_fail(RESULT_MISMATCH, "no process for a site: %s", strerror(errno));
    if (site->holder == 0) {
        prctl(PR_SET_PDEATHSIG, SIGKILL);
        if (unshare(CLONE_NEWNET) != 0 || !raise_loopback()) _exit(1);
        if (write(ready[1], "!", 1) == 1)
            for (;;) pause();
        _exit(1);
    }
    close(ready[1]);
    char byte;
    bool held = read(ready[0], &byte, 1) == 1;
    close(ready[0]);
    char path[60];
    snprintf(path, sizeof path, "/proc/%d/ns/net", (int)site->holder);
    site->file = held ? open(path, O_RDONLY | O_CLOEXEC) : -1;
    return site->file >= 0 ? result_ok() : result_fail(RESULT_MISMATCH, "no network namespace for a site");
}

static result_t lay_cable(site_t *site, size_t index)
{
    char host[16], near[24], far[24], holder[16];
    snprintf(site->device, sizeof site->device, "cable%zu", index);
    snprintf(host, sizeof host, "10.77.%zu.1", index);
    snprintf(near, sizeof near, "10.77.%zu.1/24", index);
    snprintf(far, sizeof far, "10.77.%zu.2/24", index);
    snprintf(holder, sizeof holder, "%d", (int)site->holder);
    TRY(process_command(-1, COMMAND("ip", "link", "add", site->device, "type", "veth", "peer", "name", "eth0",
                                    "netns", holder)));
    TRY(process_command(-1, COMMAND("ip", "addr", "add", near, "dev", site->device)));
    TRY(process_command(-1, COMMAND("ip", "link", "set", site->device, "up")));
    TRY(process_command(site->file, COMMAND("ip", "addr", "add", far, "dev", "eth0")));
    TRY(process_command(site->file, COMMAND("ip", "link", "set", "eth0", "up")));
    return process_command(site->file, COMMAND("ip", "route", "add", "default", "via", host));
}

/* Does what a fault will do, once, so that one knows at the start. */
static result_t try_out(network_t *network)
{
    TRY(network_cut(network, 0, NETWORK_BOTH));
    TRY(network_thin(network, 0, 100000));
    return network_heal(network, 0);
}

result_t network_new(size_t sites, network_t **network_pointer)
{
    network_t *network = mem_zalloc(1, sizeof *network);
    result_t result = process_command(-1, COMMAND("ip", "addr", "add", NETWORK_HOST "/32", "dev", "lo"));
    for (size_t i = 0; i < sites; i++) network->sites[i].file = -1;
    for (; network->count < sites && result.code == RESULT_OK; network->count++) {
        site_t *site = &network->sites[network->count];
        result = hold_namespace(site);
        if (result.code == RESULT_OK) result = lay_cable(site, network->count);
    }
    if (result.code == RESULT_OK) result = try_out(network);
    if (result.code == RESULT_OK)
        *network_pointer = network;
    else
        network_destroy(&network);
    return result;
}

void network_destroy(network_t **network_pointer)
{
    network_t *network = *network_pointer;
    if (network == NULL) return;
    for (size_t i = 0; i < network->count; i++) {
        if (network->sites[i].file >= 0) close(network->sites[i].file);
        if (network->sites[i].holder > 0) process_kill(network->sites[i].holder);
    }
    free(network);
    *network_pointer = NULL;
}

int network_site(const network_t *network, size_t site)
{
    return network->sites[site].file;
}

/* ---- faults ------------------------------------------------------------------------------------------- */

static result_t filter(const char *what, const site_t *site, network_way_t way)
{
    if (way & NETWORK_INWARD)
        TRY(process_command(-1, COMMAND("iptables", "-w", what, "OUTPUT", "-o", site->device, "-j", "DROP")));
    if (way & NETWORK_OUTWARD)
        TRY(process_command(-1, COMMAND("iptables", "-w", what, "INPUT", "-i", site->device, "-j", "DROP")));
    return result_ok();
}

result_t network_cut(network_t *network, size_t index, network_way_t way)
{
    site_t *site = &network->sites[index];
    site->cut = way;
    return filter("-A", site, way);
}

result_t network_thin(network_t *network, size_t index, unsigned bytes_per_second)
{
    site_t *site = &network->sites[index];
    char rate[24];
    snprintf(rate, sizeof rate, "%ubps", bytes_per_second);
    site->thin = true;
    TRY(process_command(-1, COMMAND("tc", "qdisc", "add", "dev", site->device, "root", "tbf", "rate", rate,
                                    "burst", "16kb", "latency", "300ms")));
    return process_command(site->file, COMMAND("tc", "qdisc", "add", "dev", "eth0", "root", "tbf", "rate",
                                               rate, "burst", "16kb", "latency", "300ms"));
}

result_t network_heal(network_t *network, size_t index)
{
    site_t *site = &network->sites[index];
    if (site->cut) TRY(filter("-D", site, site->cut));
    site->cut = 0;
    if (!site->thin) return result_ok();
    site->thin = false;
    TRY(process_command(-1, COMMAND("tc", "qdisc", "del", "dev", site->device, "root")));
    return process_command(site->file, COMMAND("tc", "qdisc", "del", "dev", "eth0", "root"));
}
