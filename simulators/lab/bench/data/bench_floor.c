/* What this machine can do at best: a program that only echoes, and one that only wakes.
 *
 *   bench_floor echo                    prints its port, returns every datagram to its sender
 *   bench_floor timer PERIOD SPIKE      wakes every PERIOD ns by an absolute timerfd; a wake later
 *                                       than SPIKE ns prints "spike DUE WOKE"; SIGUSR1 prints
 *                                       "late COUNT P50 P99 MAX" [ns] and begins anew
 *
 * It sleeps in the kernel between events and never polls: it may run with a real-time priority.
 * Times are CLOCK_MONOTONIC [ns].
 */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <errno.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/timerfd.h>
#include <time.h>
#include <unistd.h>

#define NS 1000000000LL
#define KEPT (1 << 18)

static int64_t late[KEPT];
static size_t count;
static volatile sig_atomic_t asked;

static void die(const char *what)
{
    perror(what);
    exit(1);
}

static int64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * NS + t.tv_nsec;
}

static void echo(void)
{
    struct sockaddr_in here = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    struct sockaddr_in there;
    socklen_t size = sizeof here;
    char buffer[2048];
    int fd = socket(AF_INET, SOCK_DGRAM, 0);

    if (fd < 0 || bind(fd, (struct sockaddr *)&here, size) < 0)
        die("bind");
    if (getsockname(fd, (struct sockaddr *)&here, &size) < 0)
        die("getsockname");
    printf("port %d\n", ntohs(here.sin_port));
    for (;;) {
        size = sizeof there;
        ssize_t got = recvfrom(fd, buffer, sizeof buffer, 0, (struct sockaddr *)&there, &size);
        if (got >= 0)
            sendto(fd, buffer, (size_t)got, 0, (struct sockaddr *)&there, size);
        else if (errno != EINTR)
            die("recvfrom");
    }
}

static int rising(const void *a, const void *b)
{
    int64_t x = *(const int64_t *)a, y = *(const int64_t *)b;
    return (x > y) - (x < y);
}

static void tell(void)
{
    size_t n = count < KEPT ? count : KEPT;
    qsort(late, n, sizeof late[0], rising);
    if (n)
        printf("late %zu %lld %lld %lld\n", n, (long long)late[n / 2],
               (long long)late[n - 1 - n / 100], (long long)late[n - 1]);
    else
        printf("late 0 0 0 0\n");
    count = 0;
}

static void ask(int number)
{
    (void)number;
    asked = 1;
}

static void timer(int64_t period, int64_t spike)
{
    struct sigaction action = {.sa_handler = ask};
    int fd = timerfd_create(CLOCK_MONOTONIC, TFD_CLOEXEC);
    /* At whole periods, so that what is held beside it can wake in between. */
    int64_t due = (now_ns() / period + 1) * period;

    sigaction(SIGUSR1, &action, NULL);
    if (fd < 0)
        die("timerfd_create");
    printf("ready\n");
    for (;;) {
        struct itimerspec at = {.it_value = {due / NS, due % NS}};
        uint64_t expirations;

        if (timerfd_settime(fd, TFD_TIMER_ABSTIME, &at, NULL) < 0)
            die("timerfd_settime");
        while (read(fd, &expirations, sizeof expirations) < 0)
            if (errno != EINTR)
                die("read");
        int64_t woke = now_ns();
        late[count++ % KEPT] = woke - due;
        if (woke - due > spike)
            printf("spike %lld %lld\n", (long long)due, (long long)woke);
        if (asked) {
            asked = 0;
            tell();
        }
        do
            due += period;
        while (due <= woke);
    }
}

int main(int argc, char **argv)
{
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    setvbuf(stdout, NULL, _IOLBF, 0);
    mlockall(MCL_CURRENT | MCL_FUTURE);
    if (argc == 2 && !strcmp(argv[1], "echo"))
        echo();
    if (argc == 4 && !strcmp(argv[1], "timer"))
        timer(atoll(argv[2]), atoll(argv[3]));
    fprintf(stderr, "usage: bench_floor echo | timer PERIOD_NS SPIKE_NS\n");
    return 2;
}
