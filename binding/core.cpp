// Python interface of the deployable observer, for arrays. The GIL is released; in a batch each
// thread runs one record at a time. Python checks shapes and values.
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

#include "lanes.h"
#include "numbers.h"
#include "owned.h"
#include "parameters.h"
#include "xla.h"

extern "C" {
#include "columns.h"
#include "fluxobs_config.h"
#include "fluxobs_keep.h"
#include "fluxobs_seed.h"
#include "fluxobs_internal.h"
}

namespace nb = nanobind;

namespace {

using Matrix = nb::ndarray<const double, nb::shape<FO_N, FO_N>, nb::c_contig, nb::device::cpu>;
using Vector = nb::ndarray<const double, nb::shape<FO_N>, nb::c_contig, nb::device::cpu>;
using States = nb::ndarray<const std::uint8_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Signals = nb::ndarray<const double, nb::shape<-1, -1, FO_N>, nb::c_contig, nb::device::cpu>;

using Table = nb::ndarray<const double, nb::shape<-1, -1, 2>, nb::c_contig, nb::device::cpu>;
using Pairs = nb::ndarray<const double, nb::shape<-1, 2>, nb::c_contig, nb::device::cpu>;
using Column = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

void copy(fo_real (&target)[FO_N][FO_N], const Matrix &source) {
    for (std::size_t i = 0; i < FO_N; i++)
        for (std::size_t j = 0; j < FO_N; j++) target[i][j] = static_cast<fo_real>(source(i, j));
}

void copy(fo_real (&target)[FO_N], const Vector &source) {
    for (std::size_t i = 0; i < FO_N; i++) target[i] = static_cast<fo_real>(source(i));
}

// `field` is the wrong field, if it is known.
void check(fo_error error, const char *field) {
    const std::string where = field ? std::string(field) + ": " : std::string();
    switch (error) {
        case FO_OK: return;
        case FO_ERROR_SAMPLE_TIME:
            throw std::invalid_argument(where + "sample_time must be positive, memory ten to a million samples");
        case FO_ERROR_BASE:
            throw std::invalid_argument(where + "bases, noises, limits and priors must be positive");
        case FO_ERROR_RANGE:
            throw std::invalid_argument(
                where + "sizes do not fit each other: check the units of resistance, inductance, flux, "
                "currents and sample time");
        default: throw std::invalid_argument(where + "every parameter must be finite");
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

// The observer and its flux map as bytes: an argument of the calls in xla.cpp.
template <class Observer>
nb::ndarray<nb::numpy, std::uint8_t> image_of(const Observer &observer, const fo_map *map) {
    const std::vector<char> bytes = Parameters<Observer>::bytes(observer, map);
    auto raw = std::make_unique<std::uint8_t[]>(bytes.size());
    std::memcpy(raw.get(), bytes.data(), bytes.size());
    return owned(std::move(raw), {bytes.size()});
}

// (lanes, bytes) and twice (lanes, rows, 2) -> states, columns (count, lanes, rows), valid. `step`
// receives a state, source and current of a row, and the place of its columns; it returns `valid`.
// `together` receives this many lanes at once: their states, sources, currents, columns and
// `valid`.
template <class State, class Step, class Together>
nb::tuple run_lanes(const States &states, const Signals &source, const Signals &current,
                    unsigned threads, std::size_t count, Step step, std::size_t group,
                    Together together) {
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
        const std::size_t groups = group > 1 ? lanes / group : 0, left = lanes - groups * group;
        auto alone = [&](std::size_t lane) {
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
        };
        auto work = [&] {
            for (std::size_t task; (task = todo.fetch_add(1)) < groups + left;) {
                if (task < groups) {
                    const std::size_t lane = task * group, first = lane * rows;
                    std::vector<State> some(group);
                    std::memcpy(some.data(), states.data() + lane * sizeof(State), group * sizeof(State));
                    together(some.data(), source.data() + FO_N * first, current.data() + FO_N * first,
                             rows, columns.get() + first, plane, valid.get() + first);
                    std::memcpy(next.get() + lane * sizeof(State), some.data(), group * sizeof(State));
                } else {
                    alone(groups * group + task - groups);
                }
            }
        };
        std::vector<std::thread> pool;
        for (std::size_t i = 1; i < std::min<std::size_t>(threads, groups + left); i++)
            pool.emplace_back(work);
        work();
        for (auto &thread : pool) thread.join();
    }
    return nb::make_tuple(owned(std::move(next), {lanes, sizeof(State)}),
                          owned(std::move(columns), {count, lanes, rows}),
                          owned(std::move(valid), {lanes, rows}));
}

// ---- made from the lists of the C headers --------------------------------------------------

// (name, components) of every column or group of columns, in the order in which they are written.
nb::list outputs(bool adaptive) {
    nb::list out;
    auto add = [&](const char *name, int components) { out.append(nb::make_tuple(name, components)); };
#define NAME_VECTOR(name) add(#name, FO_N);
#define NAME_NUMBER(name) add(#name, 1);
#define NAME_MEMBER(member, name) add(#name, 1);
    FO_ESTIMATE_FIELDS(NAME_VECTOR, NAME_NUMBER)
    if (adaptive) {
        ADAPTIVE_ESTIMATE_FIELDS(NAME_MEMBER)
    }
    return out;
}

// name -> meaning, for every number that a step uses.
nb::dict meanings(bool adaptive) {
    nb::dict out;
#define MEANING(name, meaning) out[#name] = meaning;
#define MEANING_ARRAY(name, size, meaning) out[#name] = meaning;
    if (adaptive) {
        FO_ADAPTIVE_FIELDS(MEANING_ARRAY, MEANING)
        out["projection"] = "when the information is projected";
    } else {
        FO_OBSERVER_FIELDS(MEANING, MEANING_ARRAY, MEANING)
    }
    return out;
}

// Words of why a position is not valid, by number.
nb::list reasons() {
    nb::list out;
#define REASON_WORD(name, word) out.append(word);
    FO_REASONS(REASON_WORD)
    return out;
}

// name -> value, for the thresholds of the plain observer.
nb::dict thresholds() {
    nb::dict out;
#define THRESHOLD(name) out[#name] = static_cast<double>(name);
    FO_THRESHOLDS(THRESHOLD)
    return out;
}

// Reads the fields of a configuration from a mapping that must contain exactly these fields.
class Fields {
public:
    explicit Fields(const nb::dict &given) : given_(given) {}

    void matrix(const char *name, fo_real (&target)[FO_N][FO_N]) {
        copy(target, nb::cast<Matrix>(at(name)));
    }
    void vector(const char *name, fo_real (&target)[FO_N]) {
        copy(target, nb::cast<Vector>(at(name)));
    }
    void number(const char *name, fo_real &target) {
        target = static_cast<fo_real>(nb::cast<double>(at(name)));
    }
    nb::object at(const char *name) {
        if (!given_.contains(name)) throw std::invalid_argument(std::string(name) + " is missing");
        taken_++;
        return given_[name];
    }
    void end() const {
        if (taken_ != given_.size()) throw std::invalid_argument("an unknown field is given");
    }

private:
    nb::dict given_;
    std::size_t taken_ = 0;
};

// ---- configuration -----------------------------------------------------------------------------

// Settings chosen from the sizes of a machine; a setting of 0 is to be chosen.
nb::dict choose(const nb::dict &sizes, double sample_time, double memory, double current_noise,
                double drift_prior) {
    fo_sizes of;
    Fields fields(sizes);
#define TAKE_SIZE(name) fields.number(#name, of.name);
    FO_SIZES_FIELDS(TAKE_SIZE)
    fields.end();
    fo_config config;
    std::memset(&config, 0, sizeof config);
    config.sample_time = static_cast<fo_real>(sample_time);
    config.memory = static_cast<fo_real>(memory);
    config.current_noise = static_cast<fo_real>(current_noise);
    config.drift_prior = static_cast<fo_real>(drift_prior);
    fo_choose(&config, &of, FO_VOLTAGE_AUTO);
    nb::dict out;
#define ADD_POSITIVE(name, least, most) out[#name] = static_cast<double>(config.name);
#define LEFT_OUT(name)
    FO_CONFIG_FIELDS(LEFT_OUT, LEFT_OUT, LEFT_OUT, ADD_POSITIVE)
    out["length_min"] = static_cast<double>(config.length_min);
    return out;
}

std::pair<double, double> kink_weights(double share) {
    fo_real weights[2];
    fo_kink_weights(static_cast<fo_real>(share), weights);
    return {weights[0], weights[1]};
}

// name -> value, for the usual settings.
nb::dict usual() {
    nb::dict out;
#define ADD_USUAL(name, value) out[#name] = static_cast<double>(value);
    FO_USUAL(ADD_USUAL)
    return out;
}

fo_seed seed_of(const nb::dict &given) {
    fo_seed at;
    Fields fields(given);
#define TAKE_SEED(name) fields.number(#name, at.name);
    FO_SEED_FIELDS(TAKE_SEED)
    fields.end();
    return at;
}

nb::tuple counts(const fo_state &state) {
    return nb::make_tuple(state.bad_voltages, state.bad_currents, state.absurd, state.outliers,
                          state.restarts, state.outside);
}

template <class State>
State lane_of(const States &states, std::size_t lane) {
    State state;
    if (states.shape(1) != sizeof state || lane >= states.shape(0))
        throw std::invalid_argument("no such state");
    std::memcpy(&state, states.data() + lane * sizeof state, sizeof state);
    return state;
}

#define ADD(name, meaning) out[#name] = nested(observer_.name);
#define ADD_ARRAY(name, size, meaning) out[#name] = nested(observer_.name);

nb::object nested(fo_projection value) { return nb::int_(static_cast<int>(value)); }
nb::object nested(fo_real value) { return nb::float_(static_cast<double>(value)); }

template <class T, std::size_t N>
nb::object nested(const T (&values)[N]) {
    nb::list out;
    for (const T &value : values) out.append(nested(value));
    return out;
}

// A flux map with its table.
class Map {
public:
    Map() = default;
    Map(const Map &) = delete;
    Map &operator=(const Map &) = delete;

    // `given` maps every field of fo_map; its coefficients are (nodes_d, nodes_q, 2).
    void take(const nb::dict &given) {
        Fields fields(given);
        map_.kind = static_cast<fo_map_kind>(nb::cast<int>(fields.at("kind")));
        map_.magnets = nb::cast<bool>(fields.at("magnets"));
#define TAKE_MAP(name) fields.number(#name, map_.name);
        FO_MAP_FIELDS(TAKE_MAP)
        const auto table = nb::cast<Table>(fields.at("coefficients"));
        fields.end();
        map_.nodes_d = static_cast<std::int32_t>(table.shape(0));
        map_.nodes_q = static_cast<std::int32_t>(table.shape(1));
        coefficients_.resize(table.shape(0) * table.shape(1) * 2);
        for (std::size_t i = 0; i < coefficients_.size(); i++)
            coefficients_[i] = real(table.data()[i]);
        map_.coefficients = coefficients_.data();
    }
    void share(const Map &other) {
        map_ = other.map_;
        coefficients_ = other.coefficients_;
        map_.coefficients = coefficients_.data();
    }
    const fo_map &get() const { return map_; }

private:
    fo_map map_{};
    std::vector<fo_real> coefficients_;
};

class Core {
public:
    // `given` maps every field of fo_config to a number or an array of doubles. `map` is empty, or
    // maps every field of fo_map.
    Core(const nb::dict &given, const nb::dict &map) {
        Fields fields(given);
#define TAKE_MATRIX(name) fields.matrix(#name, config_.name);
#define TAKE_VECTOR(name) fields.vector(#name, config_.name);
#define TAKE_NUMBER(name) fields.number(#name, config_.name);
#define TAKE_POSITIVE(name, least, most) fields.number(#name, config_.name);
        FO_CONFIG_FIELDS(TAKE_MATRIX, TAKE_VECTOR, TAKE_NUMBER, TAKE_POSITIVE)
        fields.end();
        check(fo_init(&observer_, &config_), fo_wrong(&config_));
        if (map.size() > 0) {
            map_.take(map);
            check(fo_use_map(&observer_, &map_.get()), "flux_map");
        }
    }

    const fo_config &config() const { return config_; }
    const Map *map() const { return observer_.map ? &map_ : nullptr; }

    // (rows, 2) currents in rotor coordinates, (rows) rotor fluxes -> (rows, 9): flux, its
    // derivatives by i_d and i_q, auxiliary flux, outside
    nb::ndarray<nb::numpy, double> mapped(const Pairs &current, const Column &rotor) const {
        if (!observer_.map) throw std::invalid_argument("there is no map");
        const std::size_t rows = current.shape(0);
        if (rotor.shape(0) != rows) throw std::invalid_argument("currents and fluxes differ");
        auto out = std::make_unique<double[]>(9 * rows);
        for (std::size_t k = 0; k < rows; k++) {
            const fo_real i[2] = {real(current(k, 0)), real(current(k, 1))};
            fo_mapped at;
            fo_map_at(observer_.map, i, real(rotor(k)), &at);
            const fo_real row[9] = {at.flux[0], at.flux[1], at.by_d[0], at.by_d[1], at.by_q[0],
                                    at.by_q[1], at.auxiliary[0], at.auxiliary[1],
                                    at.outside ? fo_real(1) : fo_real(0)};
            for (std::size_t n = 0; n < 9; n++) out[9 * k + n] = row[n];
        }
        return owned(std::move(out), {rows, 9});
    }

    // name -> number or nested list, in the order of fo_observer
    nb::dict parameters() const {
        nb::dict out;
        FO_OBSERVER_FIELDS(ADD, ADD_ARRAY, ADD)
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
                write_plain(&e, row, plane);
                return e.valid;
            },
            !volt_seconds && !observer_.map && lanes_here() ? LANES : 1,
            [&](fo_state *some, const double *u, const double *i, std::size_t rows, double *columns,
                std::size_t plane, bool *valid) {
                lanes_run(&observer_, some, u, i, rows, columns, plane, valid);
            });
    }

    // state of one lane that starts at a known angle
    nb::ndarray<nb::numpy, std::uint8_t> seed(const nb::dict &given, const Vector &current) const {
        const fo_seed at = seed_of(given);
        fo_real i[FO_N];
        copy(i, current);
        fo_state state;
        std::memset(&state, 0, sizeof state);
        fo_seed_state(&observer_, &state, &at, i);
        return copies(state, 1);
    }

    nb::ndarray<nb::numpy, std::uint8_t> image() const { return image_of(observer_, observer_.map); }

    // (bad_voltages, bad_currents, absurd, outliers, restarts) of one lane
    static nb::tuple counters(const States &states, std::size_t lane) {
        return counts(lane_of<fo_state>(states, lane));
    }

    Core(const Core &) = delete;
    Core &operator=(const Core &) = delete;

private:
    fo_config config_;
    fo_observer observer_;
    Map map_;
};

class Adaptive {
public:
    // `given` maps every field of fo_adaptive_config.
    Adaptive(const Core &core, const nb::dict &given) {
        fo_adaptive_config c;
        Fields fields(given);
#define TAKE_CONFIG(name) fields.number(#name, c.name);
        FO_ADAPTIVE_CONFIG_FIELDS(TAKE_CONFIG)
        c.projection = static_cast<fo_projection>(nb::cast<int>(fields.at("projection")));
        fields.end();
        check(fo_adaptive_init(&observer_, &core.config(), &c), fo_adaptive_wrong(&core.config(), &c));
        if (core.map()) {
            map_.share(*core.map());
            check(fo_use_map(&observer_.plain, &map_.get()), "flux_map");
        }
    }
    Adaptive(const Adaptive &) = delete;
    Adaptive &operator=(const Adaptive &) = delete;

    // name -> number or nested list, in the order of fo_adaptive after its first field
    nb::dict parameters() const {
        nb::dict out;
        FO_ADAPTIVE_FIELDS(ADD_ARRAY, ADD)
        ADD(projection, )
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
                write_adaptive(&e, row, plane);
                return e.position.valid;
            },
            1, [](auto &&...) {});
    }

    // `states` with the learnt values, started at a known angle
    nb::ndarray<nb::numpy, std::uint8_t> seed(const nb::dict &given, const Vector &current,
                                              const States &states) const {
        const fo_seed at = seed_of(given);
        fo_real i[FO_N];
        copy(i, current);
        auto state = lane_of<fo_adaptive_state>(states, 0);
        fo_adaptive_seed_state(&observer_, &state, &at, i);
        return copies(state, 1);
    }

    nb::ndarray<nb::numpy, std::uint8_t> image() const {
        return image_of(observer_, observer_.plain.map);
    }

    // the same as Core::counters
    static nb::tuple counters(const States &states, std::size_t lane) {
        return counts(lane_of<fo_adaptive_state>(states, lane).plain);
    }

    // name -> number or list, for the learnt values
    nb::dict learnt(const States &states, std::size_t lane) const {
        const auto state = lane_of<fo_adaptive_state>(states, lane);
        fo_learnt found;
        fo_adaptive_learnt(&observer_, &state, &found);
        nb::dict out;
#define ADD_LEARNT(name) out[#name] = nested(found.name);
        FO_LEARNT_FIELDS(ADD_LEARNT, ADD_LEARNT)
        return out;
    }

    // every lane's state, reset except for its learnt values
    nb::ndarray<nb::numpy, std::uint8_t> restart(const States &states, bool frozen) const {
        const std::size_t lanes = states.shape(0), size = sizeof(fo_adaptive_state);
        auto raw = std::make_unique<std::uint8_t[]>(lanes * size);
        for (std::size_t lane = 0; lane < lanes; lane++) {
            auto state = lane_of<fo_adaptive_state>(states, lane);
            fo_adaptive_restart(&observer_, &state, frozen);
            std::memcpy(raw.get() + lane * size, &state, size);
        }
        return owned(std::move(raw), {lanes, size});
    }

    // how often the filter's guard restarted it
    static std::uint32_t restarts(const States &states, std::size_t lane) {
        return lane_of<fo_adaptive_state>(states, lane).restarts;
    }

private:
    fo_adaptive observer_;
    Map map_;
};

}  // namespace

NB_MODULE(FLUXOBS_MODULE, m) {
    nb::class_<Core>(m, "Core")
        .def(nb::init<const nb::dict &, const nb::dict &>(), nb::arg("config"), nb::arg("map"))
        .def("parameters", &Core::parameters)
        .def("reset", &Core::reset)
        .def("mapped", &Core::mapped)
        .def("seed", &Core::seed)
        .def("run", &Core::run)
        .def("image", &Core::image)
        .def_static("counters", &Core::counters);
    nb::class_<Adaptive>(m, "Adaptive")
        .def(nb::init<const Core &, const nb::dict &>(), nb::arg("core"), nb::arg("config"))
        .def("parameters", &Adaptive::parameters)
        .def("reset", &Adaptive::reset)
        .def("run", &Adaptive::run)
        .def("image", &Adaptive::image)
        .def_static("counters", &Adaptive::counters)
        .def("learnt", &Adaptive::learnt)
        .def("seed", &Adaptive::seed)
        .def("restart", &Adaptive::restart)
        .def_static("restarts", &Adaptive::restarts);
    m.attr("outputs") = outputs(false);
    m.attr("adaptive_outputs") = outputs(true);
    m.attr("meanings") = meanings(false);
    m.attr("adaptive_meanings") = meanings(true);
    m.attr("thresholds") = thresholds();
    m.def("choose", &choose, nb::arg("sizes"), nb::arg("sample_time"), nb::arg("memory") = 0.0,
          nb::arg("current_noise") = 0.0, nb::arg("drift_prior") = 0.0);
    m.def("kink_weights", &kink_weights, nb::arg("share"));
    m.attr("usual") = usual();
    m.attr("lanes") = lanes_here() ? static_cast<int>(LANES) : 1;
    m.attr("xla_step") = nb::capsule(reinterpret_cast<void *>(&xla_step));
    m.attr("xla_adaptive_step") = nb::capsule(reinterpret_cast<void *>(&xla_adaptive_step));
    m.attr("layout") = static_cast<int>(FO_LAYOUT);
    m.attr("reasons") = reasons();
    m.attr("state_bytes") = sizeof(fo_state);
    m.attr("adaptive_state_bytes") = sizeof(fo_adaptive_state);
}
