// Python's view of the deployable observer. Arrays in, arrays out, the GIL released; a batch runs
// one record a thread at a time. All checks of shapes and values happen in Python.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/pair.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <memory>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "fluxobs_adaptive.h"

namespace nb = nanobind;

namespace {

using Matrix = nb::ndarray<const double, nb::shape<FO_N, FO_N>, nb::c_contig, nb::device::cpu>;
using Vector = nb::ndarray<const double, nb::shape<FO_N>, nb::c_contig, nb::device::cpu>;
using States = nb::ndarray<const std::uint8_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Signals = nb::ndarray<const double, nb::shape<-1, -1, FO_N>, nb::c_contig, nb::device::cpu>;

enum Column {
    FLUX = 0,
    PSI_F = FO_N,
    THETA_E,
    THETA_E_TRACKED,
    SPEED_E,
    DRIFT,
    THETA_E_STD = DRIFT + FO_N,
    INNOVATION,
    NOISE_SHARE,
    COLUMNS
};

void copy(fo_real (&target)[FO_N][FO_N], const Matrix &source) {
    for (std::size_t i = 0; i < FO_N; i++)
        for (std::size_t j = 0; j < FO_N; j++) target[i][j] = static_cast<fo_real>(source(i, j));
}

void copy(fo_real (&target)[FO_N], const Vector &source) {
    for (std::size_t i = 0; i < FO_N; i++) target[i] = static_cast<fo_real>(source(i));
}

// Beyond the range of single precision a number is infinite; the cast alone would be undefined.
fo_real real(double x) {
    constexpr double most = std::numeric_limits<fo_real>::max();
    if (std::abs(x) > most)
        return std::copysign(std::numeric_limits<fo_real>::infinity(), static_cast<fo_real>(x < 0 ? -1 : 1));
    return static_cast<fo_real>(x);
}

template <class T>
nb::ndarray<nb::numpy, T> owned(std::unique_ptr<T[]> data, std::initializer_list<std::size_t> shape) {
    nb::capsule owner(data.get(), [](void *p) noexcept { delete[] static_cast<T *>(p); });
    return nb::ndarray<nb::numpy, T>(data.release(), shape, owner);
}

void check(fo_error error) {
    switch (error) {
        case FO_OK: return;
        case FO_ERROR_SAMPLE_TIME:
            throw std::invalid_argument("sample_time must be positive, memory ten to a million samples");
        case FO_ERROR_BASE:
            throw std::invalid_argument("bases, noises, limits and priors must be positive");
        case FO_ERROR_RANGE:
            throw std::invalid_argument(
                "sizes do not fit each other: check the units of resistance, inductance, flux, "
                "currents and sample time");
        default: throw std::invalid_argument("every parameter must be finite");
    }
}

// Every lane's state, as bytes.
template <class State>
nb::ndarray<nb::numpy, std::uint8_t> copies(const State &state, std::size_t lanes) {
    auto raw = std::make_unique<std::uint8_t[]>(lanes * sizeof state);
    for (std::size_t i = 0; i < lanes; i++)
        std::memcpy(raw.get() + i * sizeof state, &state, sizeof state);
    return owned(std::move(raw), {lanes, sizeof state});
}

// (lanes, bytes), (lanes, rows, 2) twice -> states, columns (count, lanes, rows), valid. `step`
// takes a state, source and current of a row, and where its columns begin; it returns `valid`.
template <class State, class Step>
nb::tuple run_lanes(const States &states, const Signals &source, const Signals &current,
                    unsigned threads, std::size_t count, Step step) {
    const std::size_t lanes = current.shape(0), rows = current.shape(1), plane = lanes * rows;
    if (states.shape(0) != lanes || states.shape(1) != sizeof(State) || source.shape(0) != lanes ||
        source.shape(1) != rows)
        throw std::invalid_argument("states, voltage and current do not match");
    std::unique_ptr<std::uint8_t[]> next(new std::uint8_t[lanes * sizeof(State)]);
    std::unique_ptr<double[]> columns(new double[count * plane]);
    std::unique_ptr<bool[]> valid(new bool[plane]);
    {
        nb::gil_scoped_release release;
        std::atomic<std::size_t> todo{0};
        auto work = [&] {
            for (std::size_t lane; (lane = todo.fetch_add(1)) < lanes;) {
                State state;
                std::memcpy(&state, states.data() + lane * sizeof state, sizeof state);
                for (std::size_t k = lane * rows; k < (lane + 1) * rows; k++) {
                    fo_real u[FO_N], i[FO_N];
                    for (std::size_t n = 0; n < FO_N; n++) {
                        u[n] = real(source.data()[FO_N * k + n]);
                        i[n] = real(current.data()[FO_N * k + n]);
                    }
                    valid[k] = step(state, u, i, columns.get() + k, plane);
                }
                std::memcpy(next.get() + lane * sizeof state, &state, sizeof state);
            }
        };
        std::vector<std::thread> pool;
        for (std::size_t i = 1; i < std::min<std::size_t>(threads, lanes); i++)
            pool.emplace_back(work);
        work();
        for (auto &thread : pool) thread.join();
    }
    return nb::make_tuple(owned(std::move(next), {lanes, sizeof(State)}),
                          owned(std::move(columns), {count, lanes, rows}),
                          owned(std::move(valid), {lanes, rows}));
}

void write(const fo_estimate &e, double *row, std::size_t plane) {
    for (int n = 0; n < FO_N; n++) {
        row[(FLUX + n) * plane] = e.flux[n];
        row[(DRIFT + n) * plane] = e.drift[n];
    }
    row[PSI_F * plane] = e.psi_f;
    row[THETA_E * plane] = e.theta_e;
    row[THETA_E_TRACKED * plane] = e.theta_e_tracked;
    row[SPEED_E * plane] = e.speed_e;
    row[THETA_E_STD * plane] = e.theta_e_std;
    row[INNOVATION * plane] = e.innovation;
    row[NOISE_SHARE * plane] = e.noise_share;
}

nb::tuple counts(const fo_state &state) {
    return nb::make_tuple(state.bad_voltages, state.bad_currents, state.absurd, state.outliers,
                          state.restarts);
}

template <class State>
State lane_of(const States &states, std::size_t lane) {
    State state;
    if (states.shape(1) != sizeof state || lane >= states.shape(0))
        throw std::invalid_argument("no such state");
    std::memcpy(&state, states.data() + lane * sizeof state, sizeof state);
    return state;
}

// Every number a step uses, in the order of the struct.
#define FO_OBSERVER_FIELDS(X)                                                                    \
    X(Q1x2) X(E) X(row_Q2) X(row_Q3) X(row_C) X(row_s) X(hR) X(hB) X(h) X(rho) X(reinject)        \
    X(plausible) X(noise_information) X(flux_base) X(drift_base) X(current_limit) X(over_noise)   \
    X(square_min) X(L_position) X(position_noise) X(sample_time) X(track)
#define FO_SIZE(name) +sizeof(fo_observer::name)
static_assert(sizeof(fo_observer) == 0 FO_OBSERVER_FIELDS(FO_SIZE), "a field is missing");

#define FO_ADD(name) out[#name] = nested(observer_.name);

nb::object nested(fo_projection value) { return nb::int_(static_cast<int>(value)); }
nb::object nested(fo_real value) { return nb::float_(static_cast<double>(value)); }

template <class T, std::size_t N>
nb::object nested(const T (&values)[N]) {
    nb::list out;
    for (const T &value : values) out.append(nested(value));
    return out;
}

class Core {
public:
    Core(const Matrix &Q1, const Matrix &Q2, const Matrix &Q3, const Vector &E, const Vector &C,
         const Matrix &R, const Matrix &B, double L_position, double sample_time, double memory,
         double flux_base, double constraint_base, double constraint_noise, double current_noise,
         double current_limit, double drift_prior, double length_min, double tracker_bandwidth) {
        fo_config &c = config_;
        copy(c.Q1, Q1);
        copy(c.Q2, Q2);
        copy(c.Q3, Q3);
        copy(c.E, E);
        copy(c.C, C);
        copy(c.R, R);
        copy(c.B, B);
        c.L_position = static_cast<fo_real>(L_position);
        c.sample_time = static_cast<fo_real>(sample_time);
        c.memory = static_cast<fo_real>(memory);
        c.flux_base = static_cast<fo_real>(flux_base);
        c.constraint_base = static_cast<fo_real>(constraint_base);
        c.constraint_noise = static_cast<fo_real>(constraint_noise);
        c.current_noise = static_cast<fo_real>(current_noise);
        c.current_limit = static_cast<fo_real>(current_limit);
        c.drift_prior = static_cast<fo_real>(drift_prior);
        c.length_min = static_cast<fo_real>(length_min);
        c.tracker_bandwidth = static_cast<fo_real>(tracker_bandwidth);
        check(fo_init(&observer_, &c));
    }

    const fo_config &config() const { return config_; }

    // name -> number or nested list, in the order of fo_observer
    nb::dict parameters() const {
        nb::dict out;
        FO_OBSERVER_FIELDS(FO_ADD)
        return out;
    }

    nb::ndarray<nb::numpy, std::uint8_t> reset(std::size_t lanes) const {
        fo_state state;
        std::memset(&state, 0, sizeof state);
        fo_reset(&observer_, &state);
        return copies(state, lanes);
    }

    nb::tuple run(const States &states, const Signals &source, const Signals &current,
                  bool volt_seconds, unsigned threads) const {
        return run_lanes<fo_state>(
            states, source, current, threads, COLUMNS,
            [&](fo_state &state, const fo_real *u, const fo_real *i, double *row, std::size_t plane) {
                fo_estimate e;
                if (volt_seconds)
                    fo_step_volt_seconds(&observer_, &state, u, i, &e);
                else
                    fo_step(&observer_, &state, u, i, &e);
                write(e, row, plane);
                return e.valid;
            });
    }

    // (bad_voltages, bad_currents, absurd, outliers, restarts) of one lane
    static nb::tuple counters(const States &states, std::size_t lane) {
        return counts(lane_of<fo_state>(states, lane));
    }

private:
    fo_config config_;
    fo_observer observer_;
};

enum AdaptiveColumn {
    DRIFT_STD = COLUMNS,
    MAGNET_FLUX,
    MAGNET_FLUX_STD,
    RESISTANCE_ERROR,
    RESISTANCE_STD,
    INVERTER_VOLTAGE,
    INVERTER_STD,
    THETA_OTHER,
    WEIGHT_OTHER,
    ADAPTING,
    ADAPTIVE_COLUMNS
};

#define FO_ADAPTIVE_FIELDS(X)                                                                     \
    X(saliency) X(mean) X(variance) X(walk) X(noise) X(through_R) X(decoy)                        \
    X(charge) X(over_current) X(knee) X(projection)
#define FO_ADAPTIVE_SIZE(name) +sizeof(fo_adaptive::name)
static_assert(sizeof(fo_adaptive) - sizeof(fo_observer) - (0 FO_ADAPTIVE_FIELDS(FO_ADAPTIVE_SIZE)) <
                  sizeof(fo_real),
              "a field is missing");

class Adaptive {
public:
    Adaptive(const Core &core, double saliency, double psi_f, double psi_f_std,
             double resistance_std, double inverter_voltage, double inverter_std,
             double inverter_current, double slow_memory, int projection) {
        fo_adaptive_config c;
        c.saliency = static_cast<fo_real>(saliency);
        c.psi_f = static_cast<fo_real>(psi_f);
        c.psi_f_std = static_cast<fo_real>(psi_f_std);
        c.resistance_std = static_cast<fo_real>(resistance_std);
        c.inverter_voltage = static_cast<fo_real>(inverter_voltage);
        c.inverter_std = static_cast<fo_real>(inverter_std);
        c.inverter_current = static_cast<fo_real>(inverter_current);
        c.slow_memory = static_cast<fo_real>(slow_memory);
        c.projection = static_cast<fo_projection>(projection);
        check(fo_adaptive_init(&observer_, &core.config(), &c));
    }

    // name -> number or nested list, in the order of fo_adaptive after its first field
    nb::dict parameters() const {
        nb::dict out;
        FO_ADAPTIVE_FIELDS(FO_ADD)
        return out;
    }

    nb::ndarray<nb::numpy, std::uint8_t> reset(std::size_t lanes) const {
        fo_adaptive_state state;
        std::memset(&state, 0, sizeof state);
        fo_adaptive_reset(&observer_, &state);
        return copies(state, lanes);
    }

    nb::tuple run(const States &states, const Signals &source, const Signals &current,
                  bool volt_seconds, unsigned threads) const {
        return run_lanes<fo_adaptive_state>(
            states, source, current, threads, ADAPTIVE_COLUMNS,
            [&](fo_adaptive_state &state, const fo_real *u, const fo_real *i, double *row,
                std::size_t plane) {
                fo_adaptive_estimate e;
                if (volt_seconds)
                    fo_adaptive_step_volt_seconds(&observer_, &state, u, i, &e);
                else
                    fo_adaptive_step(&observer_, &state, u, i, &e);
                write(e.position, row, plane);
                row[DRIFT_STD * plane] = e.drift_std;
                row[MAGNET_FLUX * plane] = e.psi_f;
                row[MAGNET_FLUX_STD * plane] = e.psi_f_std;
                row[RESISTANCE_ERROR * plane] = e.resistance_error;
                row[RESISTANCE_STD * plane] = e.resistance_std;
                row[INVERTER_VOLTAGE * plane] = e.inverter_voltage;
                row[INVERTER_STD * plane] = e.inverter_std;
                row[THETA_OTHER * plane] = e.theta_other;
                row[WEIGHT_OTHER * plane] = e.weight_other;
                row[ADAPTING * plane] = e.adapting;
                return e.position.valid;
            });
    }

    // as of Core
    static nb::tuple counters(const States &states, std::size_t lane) {
        return counts(lane_of<fo_adaptive_state>(states, lane).plain);
    }

    // whether the filter runs, how often its guard restarted it, mean p and covariance U D U' of
    // (flux, drift, magnet flux, resistance error, inverter), per-unit
    static nb::tuple filter(const States &states, std::size_t lane) {
        const auto state = lane_of<fo_adaptive_state>(states, lane);
        return nb::make_tuple(state.running, state.restarts, nested(state.p), nested(state.U),
                              nested(state.D));
    }

private:
    fo_adaptive observer_;
};

}  // namespace

NB_MODULE(FLUXOBS_MODULE, m) {
    nb::class_<Core>(m, "Core")
        .def(nb::init<const Matrix &, const Matrix &, const Matrix &, const Vector &, const Vector &,
                      const Matrix &, const Matrix &, double, double, double, double, double, double,
                      double, double, double, double, double>(),
             nb::kw_only(), nb::arg("Q1"), nb::arg("Q2"), nb::arg("Q3"), nb::arg("E"), nb::arg("C"),
             nb::arg("R"), nb::arg("B"), nb::arg("L_position"), nb::arg("sample_time"),
             nb::arg("memory"), nb::arg("flux_base"), nb::arg("constraint_base"),
             nb::arg("constraint_noise"), nb::arg("current_noise"), nb::arg("current_limit"),
             nb::arg("drift_prior"), nb::arg("length_min"), nb::arg("tracker_bandwidth"))
        .def("parameters", &Core::parameters)
        .def("reset", &Core::reset)
        .def("run", &Core::run)
        .def_static("counters", &Core::counters);
    nb::class_<Adaptive>(m, "Adaptive")
        .def(nb::init<const Core &, double, double, double, double, double, double, double, double,
                      int>(),
             nb::arg("core"), nb::kw_only(), nb::arg("saliency"), nb::arg("psi_f"),
             nb::arg("psi_f_std"), nb::arg("resistance_std"), nb::arg("inverter_voltage"),
             nb::arg("inverter_std"), nb::arg("inverter_current"), nb::arg("slow_memory"),
             nb::arg("projection"))
        .def("parameters", &Adaptive::parameters)
        .def("reset", &Adaptive::reset)
        .def("run", &Adaptive::run)
        .def_static("counters", &Adaptive::counters)
        .def_static("filter", &Adaptive::filter);
    m.attr("state_bytes") = sizeof(fo_state);
    m.attr("adaptive_state_bytes") = sizeof(fo_adaptive_state);
}
