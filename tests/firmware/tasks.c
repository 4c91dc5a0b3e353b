/* The adaptive observer in two tasks: `tasks MODE`, with samples (voltage, current) on stdin.
 *
 *   a number  the learner is called at every N-th sample, after the interrupt
 *   signals   a timer's signal is the interrupt: it preempts the learner at any instruction
 *   threads   two threads, as on two cores
 *
 * Writes angle, its std and validity of every sample. See test_two_tasks.py.
 *
 * SPDX-License-Identifier: MIT
 */
#define _GNU_SOURCE
#include "motor_observer.h"

#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/time.h>
#include <time.h>

enum { MOST = 200000 };
/* Most samples between two calls of the learner: a busy computer may hold up its task. */
enum { WAITING = 50 };

static double samples[MOST][4], results[MOST][3];
static int count;
static volatile int done;
static int next;
static fo_adaptive_state state;
/* Calls of the learner, and the sample at which the interrupt saw the last one. The accesses are
 * relaxed: they order nothing, so the thread sanitizer still sees every race. */
static unsigned calls, calls_seen;
static int seen_at;

/* Whether the learner keeps up; if not, the interrupt waits with the next sample. */
static int keeps_up(void)
{
    const unsigned now = __atomic_load_n(&calls, __ATOMIC_RELAXED);
    if (now != calls_seen) {
        calls_seen = now;
        seen_at = next;
    }
    return next - seen_at < WAITING;
}

static void learn(void)
{
    (void)fo_adaptive_learn(&motor_observer, &state);
    (void)__atomic_add_fetch(&calls, 1, __ATOMIC_RELAXED);
}

static void interrupt(void)
{
    fo_adaptive_estimate e;
    if (next < count) {
        const double *sample = samples[next];
        const fo_real u[FO_N] = {(fo_real)sample[0], (fo_real)sample[1]};
        const fo_real i[FO_N] = {(fo_real)sample[2], (fo_real)sample[3]};
        fo_adaptive_fast_step(&motor_observer, &state, u, i, &e);
        results[next][0] = (double)e.position.theta_e;
        results[next][1] = (double)e.position.theta_e_std;
        results[next][2] = e.position.valid ? 1.0 : 0.0;
        next++;
    }
    if (next == count) {
        __atomic_store_n(&done, 1, __ATOMIC_RELEASE);
    }
}

/* The timer starts again after each interrupt, so the learner always runs in between. */
static void arm(void)
{
    const struct itimerval after = {{0, 0}, {0, 15}};
    (void)setitimer(ITIMER_REAL, &after, NULL);
}

static void on_signal(int number)
{
    (void)number;
    if (keeps_up()) {
        interrupt();
    }
    if (next < count) {
        arm();
    }
}

static void *interrupts(void *unused)
{
    const struct timespec pause = {0, 1000};
    while (next < count) {
        if (keeps_up()) {
            interrupt();
        }
        if (next % 4 == 0 || !keeps_up()) { /* both tasks advance by a similar amount */
            (void)nanosleep(&pause, NULL);
        }
    }
    return unused;
}

static void *learner(void *unused)
{
    while (!__atomic_load_n(&done, __ATOMIC_ACQUIRE)) {
        learn();
    }
    return unused;
}

int main(int argc, char **argv)
{
    const char *mode = argc > 1 ? argv[1] : "1";
    while (count < MOST && fread(samples[count], sizeof samples[0], 1, stdin) == 1) {
        count++;
    }
    fo_adaptive_reset(&motor_observer, &state);
    if (strcmp(mode, "signals") == 0) {
        (void)signal(SIGALRM, on_signal);
        arm();
        (void)learner(NULL);
    } else if (strcmp(mode, "threads") == 0) {
        pthread_t two[2];
        (void)pthread_create(&two[0], NULL, interrupts, NULL);
        (void)pthread_create(&two[1], NULL, learner, NULL);
        (void)pthread_join(two[0], NULL);
        (void)pthread_join(two[1], NULL);
    } else {
        const int every = atoi(mode);
        while (next < count) {
            interrupt();
            if (next % every == 0) {
                (void)fo_adaptive_learn(&motor_observer, &state);
            }
        }
    }
    return fwrite(results, sizeof results[0], (size_t)count, stdout) == (size_t)count ? 0 : 1;
}
