/* fluxobs for C++11 and later: no exceptions, no heap, no virtual functions. All algorithms are in
 * the C sources; this class only joins an observer with its state.
 *
 *     fluxobs::Observer<fo_observer> motor(motor_observer);       // an export's parameters
 *     const fo_estimate &now = motor.step({u_alpha, u_beta}, {i_alpha, i_beta});
 *     if (now.valid) { ... now.theta_e_tracked, now.speed_e ... }
 *
 * The adaptive observer is Observer<fo_adaptive>. Both observers have position().
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef FLUXOBS_HPP
#define FLUXOBS_HPP

#include "fluxobs_seed.h"

namespace fluxobs {

/* A vector in the stator frame (alpha, beta). */
struct Vector {
    fo_real alpha, beta;
};

namespace detail {

template <class Parameters> struct Kind;

template <> struct Kind<fo_observer> {
    using State = fo_state;
    using Estimate = fo_estimate;
    static void reset(const fo_observer &o, State &s) { fo_reset(&o, &s); }
    static void seed(const fo_observer &o, State &s, const fo_seed &at, const fo_real i[FO_N]) {
        fo_seed_state(&o, &s, &at, i);
    }
    static void step(const fo_observer &o, State &s, const fo_real u[FO_N], const fo_real i[FO_N],
                     Estimate &e) {
        fo_step(&o, &s, u, i, &e);
    }
    static void step_for(const fo_observer &o, State &s, fo_real duration, const fo_real u[FO_N],
                         const fo_real i[FO_N], Estimate &e) {
        fo_step_for(&o, &s, duration, u, i, &e);
    }
    static const fo_estimate &position(const Estimate &e) { return e; }
    static const fo_state &counts(const State &s) { return s; }
};

#if FO_ADAPTIVE
template <> struct Kind<fo_adaptive> {
    using State = fo_adaptive_state;
    using Estimate = fo_adaptive_estimate;
    static void reset(const fo_adaptive &o, State &s) { fo_adaptive_reset(&o, &s); }
    static void seed(const fo_adaptive &o, State &s, const fo_seed &at, const fo_real i[FO_N]) {
        fo_adaptive_seed_state(&o, &s, &at, i);
    }
    static void step(const fo_adaptive &o, State &s, const fo_real u[FO_N], const fo_real i[FO_N],
                     Estimate &e) {
        fo_adaptive_step(&o, &s, u, i, &e);
    }
    static void step_for(const fo_adaptive &o, State &s, fo_real duration, const fo_real u[FO_N],
                         const fo_real i[FO_N], Estimate &e) {
        fo_adaptive_step_for(&o, &s, duration, u, i, &e);
    }
    static const fo_estimate &position(const Estimate &e) { return e.position; }
    static const fo_state &counts(const State &s) { return s.plain; }
};
#endif

}  // namespace detail

/* One motor's observer. `Parameters` is fo_observer or fo_adaptive. The parameters must outlive the
 * observer. */
template <class Parameters> class Observer {
    using Kind = detail::Kind<Parameters>;

public:
    using State = typename Kind::State;
    using Estimate = typename Kind::Estimate;

    explicit Observer(const Parameters &parameters) noexcept : parameters_(&parameters) { reset(); }

    /* Resets the state: nothing is known, and all counters are 0. */
    void reset() noexcept {
        Kind::reset(*parameters_, state_);
        estimate_ = Estimate();
    }

    /* Starts at a known angle and the present current [A]. */
    void seed(const fo_seed &at, Vector current) noexcept {
        const fo_real i[FO_N] = {current.alpha, current.beta};
        Kind::seed(*parameters_, state_, at, i);
    }

    /* Processes one sample: the voltage is the mean over the interval that ends now [V], NaN if
     * unknown; the current is measured now [A]. */
    const Estimate &step(Vector voltage, Vector current) noexcept {
        const fo_real u[FO_N] = {voltage.alpha, voltage.beta}, i[FO_N] = {current.alpha, current.beta};
        Kind::step(*parameters_, state_, u, i, estimate_);
        return estimate_;
    }

    /* Like step above, for an interval of this duration [s]. */
    const Estimate &step(fo_real duration, Vector voltage, Vector current) noexcept {
        const fo_real u[FO_N] = {voltage.alpha, voltage.beta}, i[FO_N] = {current.alpha, current.beta};
        Kind::step_for(*parameters_, state_, duration, u, i, estimate_);
        return estimate_;
    }

    const Estimate &estimate() const noexcept { return estimate_; }

    /* Estimates that both kinds of observers have: flux, angle, speed, drift, valid. */
    const fo_estimate &position() const noexcept { return Kind::position(estimate_); }

    /* Counters of bad samples and restarts: bad_voltages, bad_currents, absurd, outliers, restarts. */
    const fo_state &counts() const noexcept { return Kind::counts(state_); }

    State &state() noexcept { return state_; }

    /* Replaces the parameters by others in the same units, as fo_take does; keeps the state. */
    void use(const Parameters &parameters) noexcept { parameters_ = &parameters; }

private:
    const Parameters *parameters_;
    State state_;
    Estimate estimate_;
};

}  // namespace fluxobs

#endif
