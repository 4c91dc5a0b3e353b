/* Is the machine that of the file, exactly? Derivation: docs/theory.md, section 20. */
#ifndef FLUXOBS_EXACT_FILE_H
#define FLUXOBS_EXACT_FILE_H

#include "posterior.h"

#ifdef __cplusplus
extern "C" {
#endif

/* What has been learnt; whether psi_f was guessed from the log, so that it is no value of the file; and a course to work
 * on, an element for each row. */
typedef struct {
    const fo_work *work;
    const fo_prior *prior;
    bool guessed;
    fo_course *course;
} fo_trial;

/* Learns again with R, L and psi_f of the file. True: they explain the log as well; `posterior` and the course of the
 * trial are those with these values. The covariance is then that of the others; fo_smooth_parts gives that of all. */
bool fo_try_file(const fo_trial *trial, fo_posterior *posterior);

#ifdef __cplusplus
}
#endif
#endif
