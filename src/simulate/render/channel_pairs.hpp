// SPDX-License-Identifier: Apache-2.0
// Calls a function for each pair of corresponding per-ray arrays of two scans. All code
// that joins, merges, bins or copies scans uses these functions. Private to render.
#pragma once

#include <cstddef>
#include <utility>
#include <variant>
#include <vector>

#include <relidar/log/channels.hpp>
#include <relidar/simulate/render.hpp>

namespace relidar {

/// Calls visit(info, values of `from`, values of `to`) for each basic channel that is
/// rendered. Leaves out time and ring, because they belong to the rays.
template <class Visit>
void for_each_basic_pair(const RenderedScan& from, RenderedScan& to, Visit&& visit) {
    const BasicChannels& basic = basic_channels();
    visit(basic.range, from.image.range_m, to.image.range_m);
    visit(basic.median_range, from.median_range_m, to.median_range_m);
    visit(basic.mean_range, from.mean_range_m, to.mean_range_m);
    visit(basic.intensity, from.image.intensity, to.image.intensity);
    visit(basic.drop_prob, from.image.drop_prob, to.image.drop_prob);
    visit(basic.weight, from.weight, to.weight);
    visit(basic.instance, from.instance, to.instance);
}

/// Calls visit(info, values of `from`, values of `to`) for the basic and the optional
/// channels of two scans.
/// @param to must have the channels of `from` in the same order; emptied() creates such a
/// scan
template <class Visit>
void for_each_pair(const RenderedScan& from, RenderedScan& to, Visit&& visit) {
    for_each_basic_pair(from, to, visit);
    for (std::size_t k = 0; k < to.channels.size(); ++k) {
        const auto both = [&](auto& values) {
            visit(to.channels[k].info, std::get<std::decay_t<decltype(values)>>(from.channels[k].values),
                  values);
        };
        std::visit(both, to.channels[k].values);
    }
}

}  // namespace relidar
