// SPDX-License-Identifier: Apache-2.0
// Runs the kernel scene/list_touched, which lists the surfels that have a gradient.
#include <relidar/scene/device_scene.hpp>

#include "gpu/stream.hpp"
#include "scene/shared/scene.h"

namespace relidar {

struct TouchedSurfelList::Impl {
    Device& device;
    Array<std::uint32_t, shared::TouchedRows> rows;
    Array<std::uint32_t, shared::TouchedCount> count;
    Kernel<shared::ListTouchedParams> kernel;
};

TouchedSurfelList::TouchedSurfelList(Device& device)
    : impl_(new Impl{device,
                     {},
                     {device, 1, "number of rows with a gradient"},
                     {device, "scene/list_touched", {{SpecialisationConstantId::WORKGROUP_SIZE, 128u}}}}) {}
TouchedSurfelList::~TouchedSurfelList() = default;

void TouchedSurfelList::compact(Stream& stream, Address<std::uint32_t, shared::TouchedSurfels> touched,
                                std::uint32_t n) {
    Impl& l = *impl_;
    if (l.rows.size() < n) {
        stream.submit_and_wait();  // earlier submissions may still use the old array
        l.rows.reserve(l.device, n, "rows with a gradient");
    }
    // resets the counter to 0
    stream.fill(l.count);
    // Each thread checks RELIDAR_LIST_STRETCH rows.
    run(stream, l.kernel, (n + RELIDAR_LIST_STRETCH - 1) / RELIDAR_LIST_STRETCH,
        {.touched = touched, .rows = l.rows.address(), .count = l.count.address(), .n_rows = n});
}

Address<std::uint32_t, shared::TouchedRows> TouchedSurfelList::rows_address() const {
    return impl_->rows.address();
}
Address<std::uint32_t, shared::TouchedCount> TouchedSurfelList::count_address() const {
    return impl_->count.address();
}

std::size_t TouchedSurfelList::choose_threads(std::size_t max_touched_rows) const {
    const bool is_cpu = !should_coalesce(impl_->device);
    return std::min(max_touched_rows, is_cpu ? std::size_t(1) << 12 : std::size_t(1) << 17);
}

}  // namespace relidar
