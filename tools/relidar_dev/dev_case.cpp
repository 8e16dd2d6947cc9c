// SPDX-License-Identifier: Apache-2.0
#include "dev_case.hpp"

#include <algorithm>
#include <charconv>
#include <optional>
#include <vector>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/base/error.hpp>
#include <relidar/run/run.hpp>
#include <relidar/run/stage_options.hpp>
#include <relidar/simulate/render.hpp>
#include "base/fail.hpp"
#include "scene/benchmark_street.hpp"

#include "options.hpp"

namespace relidar::cli {
namespace {

// Maximum values of options. A row is a channel, whose number has 16 bits.
constexpr long long kMaxSurfels = 50'000'000, kMaxRays = 100'000'000, kMaxRows = 65535;
constexpr float kFaintLogit = -2.19722458f;  // logit of opacity 0.1
// Highest and lowest elevation of the HDL-64E, which the rays named "kitti" use too.
constexpr double kTop_deg = 2.0, kBottom_deg = -24.9;

struct ImageSize {
    long long rows = 0;
    long long columns = 0;
};

bool parse_positive(const std::string& text, long long& parsed_value) {
    const auto [stop, error] = std::from_chars(text.data(), text.data() + text.size(), parsed_value);
    return error == std::errc() && stop == text.data() + text.size() && parsed_value >= 1;
}

/// Parses an image size such as "64x1024". Returns nothing for the name of a sensor.
std::optional<ImageSize> parse_grid_size(const std::string& text) {
    if (text == "waymo" || text == "kitti") return std::nullopt;
    const std::vector<std::string> words = split_text(text, 'x');
    ImageSize size;
    if (words.size() != 2 || !parse_positive(words[0], size.rows) ||
        !parse_positive(words[1], size.columns)) {
        fail<UsageError>("--rays: found \"{}\", expected waymo, kitti or ROWSxCOLUMNS, for example 64x1024",
                         text);
    }
    if (size.rows > kMaxRows || size.columns > kMaxRays / size.rows) {
        fail<UsageError>("--rays: found {}, expected at most {} rows and {} rays", text, kMaxRows, kMaxRays);
    }
    return size;
}

void apply_options(const BenchCaseOptions& choice, Config& config) {
    if (!choice.chunk.empty()) set_value(config, "trace.chunk", choice.chunk);
    if (!choice.keep_hits.empty()) set_value(config, "trace.keep_hits", choice.keep_hits);
    if (choice.deterministic) config.train.deterministic = true;
    if (!choice.sh.empty()) set_value(config, "image.sh_direction", choice.sh);
}

/// Converts a word of the command line to a value of an enumeration. `words` are in the
/// order of the enumeration. An empty word means `automatic`, the first value.
template <class Enum>
Enum parse_word(const char* option, const std::string& word, const std::vector<std::string>& words) {
    const auto match = word.empty() ? words.begin() : std::find(words.begin(), words.end(), word);
    if (match == words.end())
        fail<UsageError>("{}: found \"{}\", expected one of {}", option, word, fmt::join(words, ", "));
    return Enum(match - words.begin());
}

void apply_tracing_options(const BenchCaseOptions& choice, DevCase& bench) {
    apply_options(choice, bench.config);
    bench.proxy = parse_word<ProxyShape>("--proxy", choice.proxy, {"auto", "triangles", "boxes"});
    bench.traversal_mode =
        parse_word<BvhTraversalMode>("--walk", choice.traversal_mode, {"auto", "lane", "subgroup"});
    bench.order = parse_word<HitSortMethod>("--order", choice.order, {"auto", "chunks", "lists"});
    bench.keeps_more_hits = choice.keep_hits.empty();
}

/// Returns the benchmark street of the options. The surfels of the streets B and C are
/// smaller if there are more of them, and those of C are nearly transparent.
DevCase make_street_case(const BenchCaseOptions& choice) {
    const std::optional<ImageSize> size = parse_grid_size(choice.rays);
    const RayTable rays = size ? make_street_rays(int(size->rows), int(size->columns), kTop_deg, kBottom_deg)
                               : make_street_rays(choice.rays);
    const bool smaller_scales = choice.street != "A";
    DevCase bench{street_case(std::uint32_t(choice.n_surfels), smaller_scales, rays)};
    bench.name = "street " + choice.street;
    if (choice.street == "C")
        bench.scene.surfels.opacity_logit.assign(bench.scene.surfels.size(), kFaintLogit);
    return bench;
}

}  // namespace

void check_options(const BenchCaseOptions& choice) {
    if (choice.street != "A" && choice.street != "B" && choice.street != "C")
        fail<UsageError>("--scene: found \"{}\", expected A, B or C", choice.street);
    if (choice.n_surfels < 1 || choice.n_surfels > kMaxSurfels)
        fail<UsageError>("--surfels: found {}, expected a number from 1 to {}", choice.n_surfels,
                         kMaxSurfels);
    parse_grid_size(choice.rays);
    DevCase unused;
    apply_tracing_options(choice, unused);  // Called only for its error.
}

DevCase make_case(const BenchCaseOptions& choice) {
    DevCase bench =
        choice.run.empty() ? make_street_case(choice) : DevCase{case_of_run(load_run(choice.run))};
    apply_tracing_options(choice, bench);
    return bench;
}

TraceOptions trace_options(const DevCase& setup) {
    TraceOptions options = common_options(setup.config);
    options.traversal_mode = setup.traversal_mode;
    options.order = setup.order;
    return options;
}

}  // namespace relidar::cli
