/* Interface of the estimate of a whole log for a WebAssembly host. */
#include <stdint.h>

#include "arrays.h"

#define EXPORT(name) __attribute__((export_name(#name))) name

const char *EXPORT(smoothing_names)(int of)
{
    static const char *const names[] = {fo_assumption_names, fo_model_names, fo_map_names,
                                        fo_smoothed_names};
    return names[of];
}
uint32_t EXPORT(smoothing_size)(int of)
{
    static const uint32_t sizes[] = {FO_P, FO_ABOUT, FO_S, FO_BUDGET, FO_QUANTITIES};
    return sizes[of];
}
uint32_t EXPORT(block_rows)(double sample_time, double speed)
{
    return (uint32_t)fo_block_rows(sample_time, speed);
}
int EXPORT(estimate_log)(const double *numbers, const double *std, int kind, const double *map,
                         const double *coefficients, int nodes_d, int nodes_q, uint32_t rows,
                         const double *voltage, const double *current, const uint8_t *flags,
                         const double *angle, const double *angle_std, int learning, double *p,
                         double *covariance, double *about, double *columns, uint8_t *known,
                         double *budget)
{
    const fo_arrays in = {numbers, std,     map,     coefficients, kind,  nodes_d,   nodes_q,
                          rows,    voltage, current, flags,        angle, angle_std, learning};
    return fo_estimate_arrays(&in, p, covariance, about, columns, known, budget);
}
