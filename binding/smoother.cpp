// Python interface of the smoother, for arrays; Python checks shapes and values.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <new>
#include <stdexcept>
#include <string_view>
#include <utility>

#include "owned.h"

extern "C" {
#include "arrays.h"
}

namespace nb = nanobind;

namespace {

using Rows = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Table = nb::ndarray<const double, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using Column = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

constexpr std::size_t N = FO_SMOOTH;
static_assert(sizeof(fo_smooth_block) == (11 + FO_MEASUREMENTS * (N + 1)) * sizeof(double),
              "a block is a row of numbers");

using Numbers = std::unique_ptr<double[]>;

Numbers room_for(std::size_t count) { return Numbers(new double[count]); }

nb::tuple smooth(const Rows &blocks, const Table &measured, const Column &start) {
    const std::size_t count = blocks.shape(0), each = measured.shape(1), sides = measured.shape(2);
    Numbers state = room_for(count * N * sides), covariance = room_for(count * N * N),
            innovation = room_for(count * each * sides), spread = room_for(count * each),
            gain = room_for(count * each * N), work = room_for(2 * N * sides);
    const fo_smooth_room room = {state.get(),  covariance.get(), innovation.get(),
                                 spread.get(), gain.get(),       work.get()};
    {
        nb::gil_scoped_release released;
        fo_smooth(reinterpret_cast<const fo_smooth_block *>(blocks.data()), count, each,
                  measured.data(), sides, start.data(), &room);
    }
    return nb::make_tuple(
        owned(std::move(state), {count, N, sides}), owned(std::move(covariance), {count, N, N}),
        owned(std::move(innovation), {count, each, sides}),
        owned(std::move(spread), {count, each}));
}

using Marks = nb::ndarray<const std::int64_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

nb::tuple estimate(const Column &numbers, const Column &std, int kind, const Column &map,
                   const Table &coefficients, const Rows &voltage, const Rows &current,
                   const Marks &row_flags, const Column &angle, const Column &angle_std,
                   const Column &start, const Rows &covariance, double filter_scale, bool learning) {
    const std::size_t rows = voltage.shape(0), active = covariance.shape(0);
    std::unique_ptr<std::uint8_t[]> flags(new std::uint8_t[rows]);
    std::copy_n(row_flags.data(), rows, flags.get());
    const fo_arrays in = {numbers.data(),
                          std.data(),
                          map.data(),
                          coefficients.data(),
                          kind,
                          static_cast<int>(coefficients.shape(0)),
                          static_cast<int>(coefficients.shape(1)),
                          rows,
                          voltage.data(),
                          current.data(),
                          flags.get(),
                          angle.data(),
                          angle_std.data(),
                          learning ? 1 : 0};
    double sample_time = 0.0, speed = 0.0;
    std::size_t n = 0;
#define FIND(name)                                                                              \
    if (std::string_view(#name) == "sample_time") sample_time = numbers.data()[n];               \
    if (std::string_view(#name) == "speed") speed = numbers.data()[n];                           \
    n++;
    FO_MODEL_FIELDS(FIND)
#undef FIND
    const std::size_t blocks = rows / fo_block_rows(sample_time, speed);
    Numbers p = room_for(FO_P), posterior = room_for(active * active), about = room_for(FO_ABOUT),
            columns = room_for(FO_S * rows), budget = room_for(blocks * FO_QUANTITIES * FO_BUDGET);
    std::unique_ptr<std::uint8_t[]> known(new std::uint8_t[rows]);
    std::copy_n(start.data(), static_cast<std::size_t>(FO_P), p.get());
    std::copy_n(covariance.data(), active * active, posterior.get());
    about[FO_ABOUT_SCALE] = filter_scale;
    int good = 0;
    {
        nb::gil_scoped_release released;
        good = fo_estimate_arrays(&in, p.get(), posterior.get(), about.get(), columns.get(),
                                  known.get(), budget.get());
    }
    if (fo_stopped) throw std::runtime_error("stopped");
    if (!good) throw std::bad_alloc();
    return nb::make_tuple(owned(std::move(p), {FO_P}), owned(std::move(posterior), {active, active}),
                          owned(std::move(about), {FO_ABOUT}),
                          owned(std::move(columns), {FO_S, rows}), owned(std::move(known), {rows}),
                          owned(std::move(budget), {blocks, FO_QUANTITIES, FO_BUDGET}));
}

}  // namespace

NB_MODULE(_smoother, m) {
    m.def("smooth", &smooth, nb::arg("blocks"), nb::arg("measured"), nb::arg("start"));
    m.def("estimate", &estimate, nb::arg("numbers"), nb::arg("std"), nb::arg("kind"), nb::arg("map"),
          nb::arg("coefficients"), nb::arg("voltage"), nb::arg("current"), nb::arg("row_flags"),
          nb::arg("angle"), nb::arg("angle_std"), nb::arg("start"), nb::arg("covariance"),
          nb::arg("filter_scale"), nb::arg("learning"));
    m.def("stop", [] { fo_stopped = 1; });
    m.def("rows_per_block", &fo_block_rows, nb::arg("sample_time"), nb::arg("speed"));
    m.attr("assumptions") = nb::str(fo_assumption_names);
    m.attr("model_fields") = nb::str(fo_model_names);
    m.attr("map_fields") = nb::str(fo_map_names);
    m.attr("outputs") = nb::str(fo_smoothed_names);
    m.attr("states") = static_cast<int>(FO_SMOOTH);
    m.attr("measurements") = static_cast<int>(FO_MEASUREMENTS);
}
