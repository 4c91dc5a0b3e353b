// Python interface of the smoother, for arrays; Python checks shapes and values.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstddef>
#include <cstdint>
#include <memory>
#include <new>
#include <utility>

#include "owned.h"

extern "C" {
#include "estimate.h"
}

namespace nb = nanobind;

namespace {

using Rows = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Column = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

constexpr std::size_t N = FO_SMOOTH;
static_assert(sizeof(fo_smooth_block) == (9 + N) * sizeof(double), "a block is a row of numbers");

using Numbers = std::unique_ptr<double[]>;

Numbers room_for(std::size_t count) { return Numbers(new double[count]); }

nb::tuple smooth(const Rows &blocks, const Rows &measured, const Column &start) {
    const std::size_t count = blocks.shape(0), sides = measured.shape(1);
    Numbers state = room_for(count * N * sides), covariance = room_for(count * N * N),
            innovation = room_for(count * sides), spread = room_for(count),
            gain = room_for(count * N), work = room_for(2 * N * sides);
    const fo_smooth_room room = {state.get(),  covariance.get(), innovation.get(),
                                 spread.get(), gain.get(),       work.get()};
    {
        nb::gil_scoped_release released;
        fo_smooth(reinterpret_cast<const fo_smooth_block *>(blocks.data()), count, measured.data(),
                  sides, start.data(), &room);
    }
    return nb::make_tuple(
        owned(std::move(state), {count, N, sides}), owned(std::move(covariance), {count, N, N}),
        owned(std::move(innovation), {count, sides}), owned(std::move(spread), {count}));
}

using Table = nb::ndarray<const double, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using Flags = nb::ndarray<const std::uint8_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

// `numbers` are the fields of fo_model in their order, `map` those of fo_map. A vector is two
// numbers, as a row of an array.
nb::tuple estimate(const Column &numbers, const Column &std, int kind, const Column &map,
                   const Table &coefficients, const Rows &voltage, const Rows &current,
                   const Flags &measured, const Column &angle, const Column &angle_std,
                   const Column &start, const Rows &covariance, double filter_scale, bool learning,
                   bool budget) {
    fo_model model{};
    std::size_t n = 0;
#define TAKE(name) model.name = numbers.data()[n++];
    FO_MODEL_FIELDS(TAKE)
    n = 0;
#undef TAKE
#define TAKE(name) model.map.name = map.data()[n++];
    FO_MAP_FIELDS(TAKE)
#undef TAKE
    model.map.kind = static_cast<fo_map_kind>(kind);
    model.map.nodes_d = static_cast<std::int32_t>(coefficients.shape(0));
    model.map.nodes_q = static_cast<std::int32_t>(coefficients.shape(1));
    model.map.coefficients = coefficients.data();
    const std::size_t rows = voltage.shape(0);
    fo_record record{};
    record.rows = rows;
    static_assert(sizeof(vec) == 2 * sizeof(double), "a vector is two numbers");
    record.voltage = reinterpret_cast<const vec *>(voltage.data());
    record.current = reinterpret_cast<const vec *>(current.data());
    record.measured = measured.data();
    record.angle = angle.data();
    record.angle_std = angle_std.data();
    auto learnt = std::make_unique<fo_learnt>();
    std::size_t active = 0;
    for (int j = 0; j < FO_P; j++) {
        model.std[j] = std.data()[j];
        learnt->p[j] = start.data()[j];
        if (model.std[j] > 0.0) active++;
    }
    for (std::size_t j = 0; j < active * active; j++) learnt->covariance[j] = covariance.data()[j];
    learnt->filter_scale = filter_scale;
    const std::size_t blocks = fo_blocks_of(&model, rows);
    Numbers columns = room_for(FO_S * rows), share = room_for(budget ? blocks * FO_BUDGET : 1);
    std::unique_ptr<std::uint8_t[]> known(new std::uint8_t[rows]);
    const fo_estimates out = {columns.get(), known.get(), budget ? share.get() : nullptr};
    bool good = false;
    {
        nb::gil_scoped_release released;
        good = fo_estimate(&model, &record, learning, learnt.get(), &out);
    }
    if (!good) throw std::bad_alloc();
    Numbers p = room_for(FO_P), posterior = room_for(active * active), about = room_for(5);
    for (int j = 0; j < FO_P; j++) p[j] = learnt->p[j];
    for (std::size_t j = 0; j < active * active; j++) posterior[j] = learnt->covariance[j];
    about[0] = learnt->chi;
    about[1] = learnt->correlation;
    about[2] = learnt->cost;
    about[3] = learnt->filter_scale;
    about[4] = learnt->iterations;
    return nb::make_tuple(owned(std::move(p), {FO_P}), owned(std::move(posterior), {active, active}),
                          owned(std::move(about), {5}), owned(std::move(columns), {FO_S, rows}),
                          owned(std::move(known), {rows}),
                          owned(std::move(share), {budget ? blocks : 0, FO_BUDGET}));
}

std::size_t rows_per_block(double sample_time, double speed) {
    fo_model model{};
    model.sample_time = sample_time;
    model.speed = speed;
    return fo_rows_per_block(&model);
}

template <std::size_t count> nb::list names_of(const char *const (&names)[count]) {
    nb::list list;
    for (const char *name : names) list.append(name);
    return list;
}

#define NAME(name) #name,
const char *const assumptions[] = {FO_ASSUMPTIONS(NAME)};
const char *const model_fields[] = {FO_MODEL_FIELDS(NAME)};
const char *const map_fields[] = {FO_MAP_FIELDS(NAME)};
const char *const outputs[] = {FO_SMOOTHED_FIELDS(NAME)};
#undef NAME

}  // namespace

NB_MODULE(_smoother, m) {
    m.def("smooth", &smooth, nb::arg("blocks"), nb::arg("measured"), nb::arg("start"));
    m.def("estimate", &estimate, nb::arg("numbers"), nb::arg("std"), nb::arg("kind"), nb::arg("map"),
          nb::arg("coefficients"), nb::arg("voltage"), nb::arg("current"), nb::arg("measured"),
          nb::arg("angle"), nb::arg("angle_std"), nb::arg("start"), nb::arg("covariance"),
          nb::arg("filter_scale"), nb::arg("learning"), nb::arg("budget"));
    m.def("rows_per_block", &rows_per_block, nb::arg("sample_time"), nb::arg("speed"));
    m.attr("assumptions") = names_of(assumptions);
    m.attr("model_fields") = names_of(model_fields);
    m.attr("map_fields") = names_of(map_fields);
    m.attr("outputs") = names_of(outputs);
    m.attr("states") = static_cast<int>(FO_SMOOTH);
}
