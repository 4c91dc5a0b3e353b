/* Estimates as columns of numbers, for Python and for the page: their order and their names. */
#ifndef FLUXOBS_COLUMNS_H
#define FLUXOBS_COLUMNS_H

#include "fluxobs_adaptive.h"

/* Additional members of fo_adaptive_estimate, and their names as columns. */
#define ADAPTIVE_ESTIMATE_FIELDS(X)                                                      \
    X(drift_std, drift_std) X(psi_f, psi_f) X(psi_f_std, psi_f_std)                      \
    X(resistance_error, resistance_error) X(resistance_std, resistance_std)              \
    X(inverter_voltage, inverter_voltage) X(inverter_std, inverter_voltage_std)          \
    X(theta_other, theta_e_other) X(weight_other, weight_other) X(adapting, adapting)     \
    X(position.valid_reason, valid_reason)

/* Columns of the numbers of an estimate, in the order of the lists; `valid` is separate. */
#define COUNT_VECTOR(name) +FO_N
#define COUNT_NUMBER(name) +1
#define COUNT_MEMBER(member, name) +1
enum {
    COLUMNS = 0 FO_ESTIMATE_FIELDS(COUNT_VECTOR, COUNT_NUMBER),
    ADAPTIVE_COLUMNS = COLUMNS ADAPTIVE_ESTIMATE_FIELDS(COUNT_MEMBER)
};

/* Write an estimate to columns that begin at `row` and are `plane` numbers apart. */
static inline void write_plain(const fo_estimate *e, double *row, size_t plane)
{
    size_t at = 0; /* known at compile time: the places of the columns are computed once per
                    * record */
#define PUT_VECTOR(name) \
    for (int n = 0; n < FO_N; n++) row[plane * at++] = e->name[n];
#define PUT_NUMBER(name) row[plane * at++] = e->name;
    FO_ESTIMATE_FIELDS(PUT_VECTOR, PUT_NUMBER)
}

static inline void write_adaptive(const fo_adaptive_estimate *e, double *row, size_t plane)
{
    size_t at = COLUMNS;
    write_plain(&e->position, row, plane);
#define PUT_MEMBER(member, name) row[plane * at++] = (double)e->member;
    ADAPTIVE_ESTIMATE_FIELDS(PUT_MEMBER)
}

#endif
