// SPDX-License-Identifier: Apache-2.0
// The one walk over what a scan says of its rays: whoever joins, merges, bins or copies
// scans goes through it. Private to render.
#pragma once

#include <cstddef>
#include <utility>
#include <variant>
#include <vector>

#include <relidar/log/channels.hpp>
#include <relidar/simulate/render.hpp>

namespace relidar {

/// Calls visit(info, values of one, values of the other) for each basic channel that is
/// rendered; time and ring are the rays' own.
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

/// The same for all channels. @param to  has those of `from`, in their order, see
/// emptied()
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
