#include "xla.h"

#include <cstddef>
#include <cstdint>
#include <cstring>

#include "numbers.h"
#include "parameters.h"
#include "xla_interface.h"

extern "C" {
#include "columns.h"
}

namespace {

using namespace xla;

void *failure(const CallFrame &frame, const char *message) {
    ErrorArguments error = {sizeof error, nullptr, message, INVALID_ARGUMENT};
    return frame.api->error_create(&error);
}

/* ---- the call ---------------------------------------------------------------------------- */

constexpr int MAX_RANK = 8;

/* An argument or result of shape (batch..., items). */
struct Operand {
    char *data = nullptr;
    int64_t rank = 0, items = 0;
    const int64_t *dims = nullptr;

    Operand(const Buffers &buffers, int n, int dtype) {
        const auto *buffer = static_cast<const Buffer *>(buffers.items[n]);
        if (buffer->dtype != dtype || buffer->rank < 1 || buffer->rank > MAX_RANK) return;
        data = static_cast<char *>(buffer->data);
        rank = buffer->rank;
        dims = buffer->dims;
        items = dims[rank - 1];
    }

    /* Index of this operand's lane for a lane of the results; dimensions of 1 broadcast. */
    int64_t lane(int64_t of_result, const Operand &result) const {
        int64_t index = 0, stride = 1;
        for (int64_t d = result.rank - 2; d >= 0; d--) {
            const int64_t place = of_result % result.dims[d];
            of_result /= result.dims[d];
            if (dims[d] > 1) index += place * stride;
            stride *= dims[d];
        }
        return index;
    }

    bool broadcasts_to(const Operand &result) const {
        if (data == nullptr || rank != result.rank) return false;
        for (int64_t d = 0; d < rank - 1; d++)
            if (dims[d] != 1 && dims[d] != result.dims[d]) return false;
        return true;
    }
};

/* Describes the handler when XLA registers it. */
bool answered_metadata(const CallFrame &frame) {
    for (Extension *e = frame.extension_start; e != nullptr; e = e->next) {
        if (e->type != METADATA) continue;
        Metadata &metadata = *reinterpret_cast<MetadataExtension *>(e)->metadata;
        /* Every minor version has the functions used here: XLA only appends functions. */
        const bool known = frame.api != nullptr && frame.api->api_version.major_version == VERSION_MAJOR;
        const int minor = known ? frame.api->api_version.minor_version : VERSION_MINOR;
        metadata.api_version = {sizeof(Version), nullptr, VERSION_MAJOR, minor};
        metadata.traits = 0;
        return true;
    }
    return false;
}

template <class Observer, class State, class Step>
void *call(void *raw, int columns, Step step) {
    const CallFrame &frame = *static_cast<CallFrame *>(raw);
    if (answered_metadata(frame)) return nullptr;
    if (frame.args.size != 4 || frame.rets.size != 2)
        return failure(frame, "fluxobs: four arguments and two results are needed");
    const Operand parameters(frame.args, 0, U8), before(frame.args, 1, U8);
    const Operand voltage(frame.args, 2, F64), current(frame.args, 3, F64);
    const Operand after(frame.rets, 0, U8), estimate(frame.rets, 1, F64);
    if (!after.data || !estimate.data || !after.broadcasts_to(estimate) ||
        !before.broadcasts_to(after) || !parameters.broadcasts_to(after) ||
        !voltage.broadcasts_to(after) || !current.broadcasts_to(after))
        return failure(frame, "fluxobs: the batches of the arguments do not match");
    const auto state_bytes = static_cast<int64_t>(sizeof(State));
    if (after.items != state_bytes || before.items != state_bytes || voltage.items != FO_N ||
        current.items != FO_N || estimate.items != columns + 1 ||
        parameters.items < static_cast<int64_t>(sizeof(Parameters<Observer>)))
        return failure(frame, "fluxobs: an argument is of another version or precision");
    int64_t lanes = 1;
    for (int64_t d = 0; d < after.rank - 1; d++) lanes *= after.dims[d];
    int64_t loaded = -1;
    Parameters<Observer> known;
    for (int64_t k = 0; k < lanes; k++) {
        const int64_t own = parameters.lane(k, after);
        if (own != loaded) {
            const char *bytes = parameters.data + own * parameters.items;
            if (!known.load(bytes, static_cast<size_t>(parameters.items)))
                return failure(frame, "fluxobs: the parameters are of another version or precision");
            loaded = own;
        }
        State state;
        std::memcpy(&state, before.data + before.lane(k, after) * state_bytes, sizeof state);
        const auto *u = reinterpret_cast<const double *>(voltage.data) + FO_N * voltage.lane(k, after);
        const auto *i = reinterpret_cast<const double *>(current.data) + FO_N * current.lane(k, after);
        const fo_real voltage_now[FO_N] = {real(u[0]), real(u[1])};
        const fo_real current_now[FO_N] = {real(i[0]), real(i[1])};
        auto *row = reinterpret_cast<double *>(estimate.data) + (columns + 1) * k;
        row[columns] = step(known.observer(), state, voltage_now, current_now, row) ? 1.0 : 0.0;
        std::memcpy(after.data + k * state_bytes, &state, sizeof state);
    }
    return nullptr;
}

}  // namespace

extern "C" void *xla_step(void *frame) {
    return call<fo_observer, fo_state>(
        frame, COLUMNS,
        [](const fo_observer *o, fo_state &state, const fo_real *u, const fo_real *i, double *row) {
            fo_estimate e;
            fo_step(o, &state, u, i, &e);
            write_plain(&e, row, 1);
            return e.valid;
        });
}

extern "C" void *xla_adaptive_step(void *frame) {
    return call<fo_adaptive, fo_adaptive_state>(
        frame, ADAPTIVE_COLUMNS,
        [](const fo_adaptive *o, fo_adaptive_state &state, const fo_real *u, const fo_real *i,
           double *row) {
            fo_adaptive_estimate e;
            fo_adaptive_step(o, &state, u, i, &e);
            write_adaptive(&e, row, 1);
            return e.position.valid;
        });
}
