/* One thread writes estimates like an interrupt, another thread reads them. The reader must never
 * get a mixture of two estimates. */
#include <pthread.h>
#include <stdio.h>
#include <string.h>

#include "fluxobs_retune.h"

/* Written until the reader has got some: on a busy machine it may sleep for a long time. */
enum { WRITES = 3000000, READS = 100 };
static fo_snapshot shared;
static volatile bool done;
static volatile long reads;
static long written;

static void *interrupt(void *none)
{
    fo_estimate e;
    memset(&e, 0, sizeof e);
    for (long k = 1; k <= WRITES || reads < READS; k++) {
        const fo_real x = (fo_real)(k % 1000);
        written = k;
        e.flux[0] = e.flux[1] = e.psi_f = e.theta_e = e.speed_e = e.theta_e_std = e.noise_share = x;
        fo_publish(&shared, &e);
    }
    done = true;
    return none;
}

int main(void)
{
    pthread_t thread;
    fo_estimate e;
    long mixtures = 0;
    if (fo_read(&shared, &e)) {
        printf("there is an estimate before the first\n");
        return 1;
    }
    pthread_create(&thread, NULL, interrupt, NULL);
    while (!done) {
        if (fo_read(&shared, &e)) {
            const fo_real x = e.flux[0];
            reads = reads + 1;
            mixtures += e.flux[1] != x || e.psi_f != x || e.theta_e != x || e.speed_e != x ||
                        e.theta_e_std != x || e.noise_share != x;
        }
    }
    pthread_join(thread, NULL);
    const bool last = fo_read(&shared, &e) && e.psi_f == (fo_real)(written % 1000);
    printf("%ld reads, %ld mixtures\n", reads, mixtures);
    /* a count at its maximum continues with 1, as 0 means that there is no estimate */
    const uint32_t ends[2][2] = {{UINT32_MAX, 1U}, {UINT32_MAX - 1U, UINT32_MAX}};
    bool counts = true;
    for (int n = 0; n < 2; n++) {
        shared.begun = ends[n][0];
        e.psi_f = (fo_real)n;
        fo_publish(&shared, &e);
        counts = counts && fo_read(&shared, &e) && e.psi_f == (fo_real)n && shared.ended == ends[n][1];
    }
    shared.begun = 7U; /* a writer is at work */
    counts = counts && !fo_read(&shared, &e);
    return reads >= READS && mixtures == 0 && last && counts ? 0 : 1;
}
