/* Parts of a log whose course is known grow over the rows beside them. */
#ifndef FLUXOBS_GROWTH_H
#define FLUXOBS_GROWTH_H

#include "posterior.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { FO_MOST_PARTS = 32 };

/* A row belongs to a part if the filter, which follows its own prediction from a part that is known, is not
 * contradicted by the currents. So a bridge that was off, or voltages that were not those of the log, end a part; the
 * rows behind them belong to another, which hints begin. */
typedef struct {
    const fo_log *log;
    const fo_machine *machine;
    const fo_start *start;
    const double *covariance; /* of the parameters, FO_UNKNOWNS² */
    double *hints;  /* angles that others give, in any turn; NaN: none */
    double *angles; /* of the parts, without jumps of a turn; NaN outside */
    fo_part parts[FO_MOST_PARTS]; /* in the order of their rows, once they are joined */
    size_t count;
    size_t seed; /* a row of the part that is believed most */
} fo_growth;

/* Begins a part with the longest run of hints outside the parts, or with `longest` rows in its middle. False: there
 * is none. */
bool fo_begin_part(fo_growth *growth, size_t longest);

/* Grows a part at both ends. False: no memory. */
bool fo_grow_part(const fo_growth *growth, fo_part *part, const double parameters[FO_UNKNOWNS]);

/* Cuts out of a part what does not fit about its course, which has an element for each row of the log; what is left
 * may be several parts, or none. `witnesses`: a row whose angle a hint confirms fits better. */
void fo_cut_parts(fo_growth *growth, fo_course *course, const double parameters[FO_UNKNOWNS], bool witnesses);

/* Joins parts that touch each other and agree. Of two that do not agree, one is wrong: that with the seed stays, or
 * the longer one. */
void fo_join_parts(fo_growth *growth);

/* Forgets a part, and the hints on its rows. */
void fo_forget(const fo_growth *growth, const fo_part *part);

#ifdef __cplusplus
}
#endif
#endif
