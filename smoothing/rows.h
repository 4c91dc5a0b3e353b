/* From the samples of a log to blocks of samples, each with one linear measurement of the slow
 * errors, and to the sensitivities of the angle. */
#ifndef FLUXOBS_ROWS_H
#define FLUXOBS_ROWS_H

#include "model.h"
#include "smoother.h"

/* Most and fewest samples of a block, and the angle by which the rotor turns in it [rad]. */
enum { FO_LONGEST_BLOCK = 16 };
#define FO_BLOCK_ANGLE 0.35

/* Rows on each side from which the speed is fitted. */
enum { FO_SPEED_ROWS = 20 };

/* Measurements of a block: the length of the auxiliary flux, and its direction. */
enum { FO_LENGTH, FO_DIRECTION };

typedef struct {
    size_t rows;
    const vec *voltage;       /* mean over the interval that ends at the row [V]; NaN: unknown */
    const vec *current;       /* sampled at the row [A]; finite */
    const uint8_t *flags;     /* 1: the current is measured; 2, 4, 6: phase a, b, c floats in the
                               * interval that ends at the row */
    const double *angle;      /* of an observer [rad] */
    const double *angle_std;  /* infinite: the observer does not know it */
} fo_record;

static inline bool fo_is_measured(const fo_record *r, size_t row) { return (r->flags[row] & 1) != 0; }
static inline int fo_floating_phase(const fo_record *r, size_t row) { return r->flags[row] >> 1; }

/* What a block tells besides its measurement. */
typedef struct {
    double noise[FO_MEASUREMENTS]; /* variance of a measurement from the current's noise [Wb^2];
                                    * of the direction, 0: it is not measured */
    double share_d[FO_MEASUREMENTS], share_q[FO_MEASUREMENTS]; /* of that noise in the regressors
                                                                * of L_d and L_q [1] */
    double share_lag;          /* of that noise in the measurement times the regressor of the lag */
    double saliency_variance;  /* relative */
    double rotation;           /* of the rotor within the block [rad] */
    double speed, angle;       /* [rad/s], [rad] */
    vec current;               /* in rotor coordinates [A] */
    vec current_still, flux;   /* in stator coordinates [A], [Wb] */
    double voltage;            /* [V] */
    double size;               /* of the auxiliary flux, less what the residual lacks [Wb] */
    double across_noise;       /* variance of the angle from the current's noise [rad^2] */
    bool usable;
    vec across;                /* derivative of the angle by the flux [rad/Wb] */
    double across_psi;         /* and by the magnet flux */
} fo_block_facts;

/* Estimates at a row. */
typedef struct {
    vec flux;       /* [Wb] */
    double angle;   /* at the time of the row [rad] */
    double speed;   /* [rad/s] */
    double size;    /* of the auxiliary flux [Wb] */
} fo_row;

typedef struct {
    const fo_model *model;
    fo_record record;
    size_t per_block, blocks, columns; /* columns: assumptions that are not exact */
    size_t measurements;               /* of a block: 1, with an injected current 2 */
    int active[FO_P];                  /* their indices */
    double *angle, *speed;             /* per row: where the relation is linearised */
    double *unwrapped;                 /* per row: working space */
    vec *correction;                   /* per block: reference of the flux correction [Wb] */
    double *psi;                       /* per block: reference of the deviation of the flux [Wb] */
    fo_smooth_block *block;
    fo_block_facts *about;
    double *measured;                  /* blocks * measurements * (1 + columns) */
    double *across;                    /* blocks * columns: derivatives of the angle [rad] */
    vec *total;                        /* blocks * columns: derivatives of the flux [Wb] */
    double *noise;                     /* measurements * blocks * measurements: variance of an
                                        * innovation from the noise of the first, of the second
                                        * measurement of all blocks */
    fo_sign *hard, *soft;              /* per row: signs of the phase currents */
    double signs_of[4];                /* offsets and gains of the currents of these signs */
    bool signs_known, signs_filled;
    double *floating;                  /* blocks * 3: shares of the rows in which a phase floats */
    uint8_t *doubtful;                 /* per block: does not fit, so it teaches nothing */
    double start_rotor_flux;           /* cage: at the first row [Wb] */
} fo_work;

/* Relation of all rows at the assumptions p and at the reference of `w`. `rows` may be null. */
void fo_linearise(fo_work *w, const double p[FO_P], fo_row *rows);

/* Speed at each row: slope of the angle over the rows around it. */
void fo_fit_speed(fo_work *w);

/* Volt-seconds since the first row without correction [Wb], corrected current [A], and the flux of
 * the magnets or of the rotor [Wb] of all rows. */
void fo_integrate(fo_work *w, const double p[FO_P], vec *volt_seconds, vec *current,
                  double *psi);

/* Set by a host that wants its thread back: passes over the rows and learning end, without a result. */
extern volatile int fo_stopped;

/* Linear interpolation between the middles of blocks; constant beyond the first and last. */
typedef struct {
    size_t block; /* the value is (1 - share) * value[block] + share * value[block + 1] */
    double share;
} fo_place;
fo_place fo_place_of(const fo_work *w, size_t row);

#endif
