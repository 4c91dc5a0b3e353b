/* The likelihood of a log's currents, from their prediction errors (innovations).
 *
 * The measurement is the current: i_k = f(λ_k, θ_k) + n_k. The applied voltages and the *predicted*
 * current (R i, loss of the inverter) drive the flux λ. So the noise of a row enters once, in the
 * row's innovation, and the score has mean zero at the true parameters although a controller
 * answers the noise. The model is linearised about a course of flux and angle over the whole log,
 * not about the filter's own estimates: a filter that does not know the angle yet follows it all
 * the same, and smoothing gives the next course (Gauss–Newton). Derivation: docs/theory.md,
 * section 20. */
#ifndef FLUXOBS_INNOVATIONS_H
#define FLUXOBS_INNOVATIONS_H

#include <stdbool.h>
#include <stddef.h>

#include "relation.h"

#ifdef __cplusplus
extern "C" {
#endif

/* States; vectors in stator coordinates. The noise is the predictable part of coloured noise. */
enum {
    FO_FLUX,
    FO_ANGLE = 2,
    FO_SPEED, /* of the rotor; a cage's flux turns faster by the slip */
    FO_PSI,   /* flux of magnets or rotor, less the parameter */
    FO_ACCELERATION,
    FO_DRIFT,
    FO_NOISE = 8,
    FO_STATES = 10
};
/* Elements of the transition that may not be zero, and how many of them, the first, depend on the
 * parameters of the model; see innovations.c. */
enum { FO_ELEMENTS = 43, FO_BENT = 26 };
/* Derivatives of the states by all parameters but the levels, with the gain held. */
enum { FO_SENSITIVE = FO_UNKNOWNS - FO_LEVELS };
/* Rows from one checkpoint to the next. */
enum { FO_CHUNK = 64 };

/* A log. */
typedef struct {
    size_t rows;
    double sample_time;    /* [s] */
    /* rows × 2, NaN where they are missing: mean from this row to the next, with the log's lag [V] */
    const double *voltage;
    const double *current; /* [A] */
    const double *rounding; /* variance of each row that its rounding adds to its noise [A²], or null */
    size_t first, whole;   /* of a part: its place in the whole log, and the rows of this; or 0 */
    size_t periods;        /* of the inverter in a row; 0: one */
    bool early;            /* a voltage that acts early is that of the next row; else it is extrapolated */
} fo_log;

/* A log of `rows` consecutive rows of a log. */
fo_log fo_rows_of(const fo_log *log, size_t first, size_t rows);

/* What is known before the first row: standard deviations about the course. */
typedef struct {
    double flux_std, angle_std; /* [Wb], [rad] */
    double speed_std;           /* [rad/s] */
    double psi_std;             /* [Wb] */
    double acceleration_std;    /* [rad/s²] */
    double drift_std;           /* of a component [V] */
    size_t skipped;             /* rows until the innovations count */
} fo_start;

typedef struct {
    const fo_log *log;
    const fo_machine *machine;
    const fo_start *start;
    fo_course *course; /* an element for each row */
} fo_problem;

typedef struct {
    double objective;          /* ½ Σ eᵀS⁻¹e + ln det S, without constant */
    double score[FO_UNKNOWNS]; /* its derivative, from fo_backward */
    double information[FO_UNKNOWNS * FO_UNKNOWNS]; /* expected second derivative (Fisher) */
    double mean_square; /* of the normalised innovations; 1 if the levels are right */
    size_t counted;     /* rows */
} fo_likelihood;

/* The filter before the measurement of a row. */
typedef struct {
    double x[FO_STATES], P[FO_STATES][FO_STATES];
    double by[FO_STATES][FO_SENSITIVE];
    double voltage[2]; /* last known */
    double turning;    /* of the course in the last interval [rad/s] */
    double rotor[2];   /* current of the row before; rotor coordinates */
    size_t row;
    double square;     /* of the last innovation, normalised: 1 if the levels are right */
    size_t doubted;    /* last rows whose square was that of an outlier */
    size_t calm;       /* row from which on a load step may come */
    size_t unknown;    /* last rows without a voltage: it is held, and as uncertain as it is large */
} fo_filter;

/* What the filter knows at a row, for the way back. */
typedef struct {
    double own[FO_STATES];              /* after the measurement */
    double current[2], slope[2][FO_BY]; /* that makes flux, at the course, and its derivatives */
    double P[FO_STATES][FO_STATES];     /* covariance after the measurement */
    double error[2], V[2][2];           /* innovation, inverse of its covariance */
    double noise[2][2];                 /* covariance of the noise, without rounding */
    double K[FO_STATES][2];             /* Kalman gain */
    double H[2][FO_BY];                 /* derivatives of the current */
    double H_by[2][FO_BY][FO_T];        /* and theirs by the parameters of the model */
    double F[FO_ELEMENTS];              /* transition to the next row */
    double F_by[FO_BENT][FO_T];
    double error_by[2][FO_SENSITIVE];   /* derivatives of the innovation, gain held; FO_KEEP_DIRECT: state held too */
    double moved_by[FO_STATES][FO_SENSITIVE]; /* of the next state, that of this row held */
    double own_by[FO_NOISE][FO_SENSITIVE]; /* of the states but the noise, gain held */
    double current_by[2][FO_SENSITIVE]; /* of that current, with given states */
    bool measured;
} fo_row;

/* States by which the current is differentiated. */
extern const unsigned char fo_measured_states[FO_BY];
/* Rows and columns of the elements of the transition. */
extern const unsigned char fo_pattern[FO_ELEMENTS][2];

/* Elements that a machine has. */
typedef struct {
    unsigned char at[FO_ELEMENTS];
    int count, states; /* states: without those of the noise if it is white */
} fo_elements;
fo_elements fo_elements_of(const fo_model *m);

/* Checkpoints of a log: one for each chunk of its rows. */
size_t fo_checkpoints(size_t rows);

/* How much is evaluated; each contains those before. */
typedef enum {
    FO_OBJECTIVE,
    FO_OF_ALL,   /* information of all parameters */
    FO_OF_COURSE /* as before, but the information is that of the course */
} fo_detail;

/* Objective and information at the parameters: FO_L, then two coefficients of each harmonic [Wb]. False: a
 * number is not finite, or a covariance is not positive. */
bool fo_innovations(const fo_problem *problem, const double parameters[FO_UNKNOWNS], fo_detail detail,
                    fo_likelihood *out, fo_filter *checkpoints);

/* A course that follows the filter: rows whose course is given, hints at the angle of the others, NaN where there are
 * none, and the covariance of the parameters. */
typedef struct {
    size_t given;
    const double *hints;
    const double *covariance;
} fo_follower;

/* Not zero: what runs ends soon, as if the likelihood could not be evaluated. */
extern volatile int fo_interrupted;

/* Writes the course that the filter itself predicts, behind the rows that are given. Returns how many rows fit;
 * it ends where they do not, or where the angle is lost. */
size_t fo_follow(const fo_problem *problem, const double parameters[FO_UNKNOWNS],
                 const fo_follower *follower);

/* What is kept of rows that the filter passes again. */
typedef enum {
    FO_KEEP_VALUES,    /* no derivatives by parameters */
    FO_KEEP_DIRECT,    /* for the score: of each step of the filter, what it starts from held */
    FO_KEEP_SENSITIVE  /* of the states, those of the course; FO_OF_COURSE was evaluated before */
} fo_kept;

/* `count` rows from a checkpoint on again. `course`: of these rows and the next. */
void fo_again(const fo_problem *problem, const double parameters[FO_UNKNOWNS],
              const fo_filter *from, const fo_course *course, size_t count, fo_kept kept, fo_row *rows);

#ifndef FO_VALUES_ONLY
bool fo_innovations_of_values(const fo_problem *problem, const double parameters[FO_UNKNOWNS], fo_detail detail,
                              fo_likelihood *out, fo_filter *checkpoints);
void fo_again_of_values(const fo_problem *problem, const double parameters[FO_UNKNOWNS],
                        const fo_filter *from, const fo_course *course, size_t count, fo_kept kept, fo_row *rows);
#endif

#ifdef __cplusplus
}
#endif
#endif
