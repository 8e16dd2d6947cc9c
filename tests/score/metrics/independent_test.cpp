// SPDX-License-Identifier: Apache-2.0
// Compares all metrics of a pair of random images with an independent script,
// ../shared/bench/evaluate.py, which the test runs. Skipped if RELIDAR_SHARED (default:
// ../shared next to the repository) does not contain the script, or if Python lacks numpy
// or scipy.
#include <relidar/log/range_image.hpp>
#include <relidar/score/metrics.hpp>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <random>

#include <unistd.h>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <relidar/base/arrays.hpp>
#include <relidar/base/files.hpp>
#include <relidar/base/math.hpp>

namespace relidar {
namespace {

namespace fs = std::filesystem;

constexpr int kRows = 40, kColumns = 90;
constexpr std::size_t kPixels = kRows * kColumns;

struct Pair {
    RangeImage rendered, real;
    std::vector<float> moving;
};

Pair make_random_pair() {
    std::mt19937 random(20261120);
    std::uniform_real_distribution<float> unit(0.0f, 1.0f);
    std::normal_distribution<float> normal;
    Pair pair;
    pair.real.rows = pair.rendered.rows = kRows;
    pair.real.columns = pair.rendered.columns = kColumns;
    // Steps of 8 columns and 5 rows, so that only some pixels are at depth edges.
    std::vector<float> step_m(kPixels);
    for (float& range : step_m) range = 1.0f + 78.0f * unit(random);
    for (std::size_t i = 0; i < kPixels; ++i) {
        const bool dropped = unit(random) < 0.25f;
        const float range = step_m[i / kColumns / 5 * kColumns + i % kColumns / 8] *
                            (1.0f + 0.02f * unit(random)),
                    intensity = unit(random);
        pair.real.range_m.push_back(dropped ? 0.0f : range);
        pair.real.intensity.push_back(dropped ? 0.0f : intensity);
        pair.real.drop_prob.push_back(dropped ? 1.0f : 0.0f);
        pair.rendered.range_m.push_back(
            std::abs(range + (unit(random) < 0.1f ? 5.0f : 0.05f) * normal(random)) + 1e-3f);
        pair.rendered.intensity.push_back(intensity + 0.1f * normal(random));
        pair.rendered.drop_prob.push_back(dropped == (unit(random) < 0.9f) ? 0.3f + 0.7f * unit(random)
                                                                           : 0.6f * unit(random));
        // The columns cover a full turn.
        const float azimuth = -2.0f * float(kPi) * float(i % kColumns) / kColumns;
        pair.real.direction.push_back(
            glm::normalize(glm::vec3(std::cos(azimuth), std::sin(azimuth), 0.3f * normal(random))));
        pair.real.origin.emplace_back(0.0f);
        pair.moving.push_back(unit(random) < 0.05f ? 1.0f : 0.0f);
    }
    pair.rendered.direction = pair.real.direction;
    pair.rendered.origin = pair.real.origin;
    return pair;
}

constexpr const char* kScript = R"(
import sys
sys.dont_write_bytecode = True
sys.path.insert(0, sys.argv[1])
import numpy as np, evaluate
z = np.load(sys.argv[2])
for cut in (0.4, 0.5):
    evaluate.CUT = cut
    r = evaluate.score(z['range'], z['intensity'], z['drop_prob'], z['real_range'], z['real_intensity'], z['real_drop'] < 0.5,
                       dirs=z['direction'], dyn=z['moving'] > 0.5)
    for k, v in r.items(): print('%g:%s %.17g' % (cut, k, v))
g = z['real_range'].astype(float); g[z['real_drop'] >= 0.5] = np.nan
edge = np.zeros(g.shape, bool)
for axis in (0, 1):
    for step in (-1, 1):
        n = np.roll(g, step, axis)   # the columns cover a full turn, the rows do not
        if axis == 0: n[0 if step == 1 else -1] = np.nan
        edge |= (np.abs(n - g) > 0.5) & (np.abs(n - g) > 0.05 * g)
p = z['range'].astype(float)
for name, m in (('edges', edge), ('smooth', ~edge)):
    real = m & ~np.isnan(g)
    kept = m & (z['drop_prob'] < 0.5)
    both = real & kept
    for k, v in {'pixels': real.sum(), 'share': real.sum() / (~np.isnan(g)).sum(), 'returned': both.sum() / real.sum(),
                 'above_1m': (np.abs(p - g)[both] > 1).mean(), 'depth_medae_m': np.median(np.abs(np.minimum(p, 80) - np.minimum(g, 80))[real])}.items():
        print('%s/%s %.17g' % (name, k, v))
    d = z['direction'].astype(float)
    c = evaluate.chamfer(d[kept] * p[kept][:, None], d[real] * g[real][:, None])
    for k, v in {'cd_mean_m': 'cd_mean', 'cd_sq_m2': 'cd_sq', 'f_5cm': 'F5', 'f_22cm': 'F22'}.items():
        print('%s/%s %.17g' % (name, k, c[v]))
)";

std::map<std::string, double> compute_independent_scores(const fs::path& bench, const Pair& pair) {
    const fs::path folder = fs::temp_directory_path() / fmt::format("relidar-metrics-{}", ::getpid());
    fs::create_directories(folder);
    const auto image = [](const char* name, const std::vector<float>& v) {
        return make_array(name, {kRows, kColumns}, v.data(), v.size());
    };
    write_npz(folder / "pair.npz",
              {image("range", pair.rendered.range_m), image("intensity", pair.rendered.intensity),
               image("drop_prob", pair.rendered.drop_prob), image("real_range", pair.real.range_m),
               image("real_intensity", pair.real.intensity), image("real_drop", pair.real.drop_prob),
               image("moving", pair.moving),
               make_array("direction", {kRows, kColumns, 3}, &pair.real.direction[0].x, 3 * kPixels)});
    write_text_file(folder / "score.py", kScript);
    std::map<std::string, double> scores;
    for (const char* python : {"python3", "/usr/bin/python3"}) {
        const std::string command =
            fmt::format("{} '{}' '{}' '{}' >'{}' 2>/dev/null", python, (folder / "score.py").string(),
                        bench.string(), (folder / "pair.npz").string(), (folder / "scores.txt").string());
        if (std::system(command.c_str()) != 0) continue;
        std::ifstream file(folder / "scores.txt");
        std::string name;
        for (double value = 0.0; file >> name >> value;) scores[name] = value;
        break;
    }
    fs::remove_all(folder);
    return scores;
}

TEST(Metrics, AgreeWithAnIndependentScript) {
    const char* shared = std::getenv("RELIDAR_SHARED");
    const fs::path bench =
        (shared ? fs::path(shared) : fs::path(RELIDAR_SOURCE_DIR).parent_path() / "shared") / "bench";
    if (!fs::exists(bench / "evaluate.py"))
        GTEST_SKIP() << (bench / "evaluate.py") << " is not there; RELIDAR_SHARED names another folder";
    const Pair pair = make_random_pair();
    const std::map<std::string, double> expected = compute_independent_scores(bench, pair);
    if (expected.empty()) GTEST_SKIP() << "no python3 with numpy and scipy";
    const std::vector<bool> moving(pair.moving.begin(), pair.moving.end());
    const MetricValues actual_metrics =
        evaluate_all({{&pair.rendered, &pair.real, make_regions(pair.real, moving)}}).front();
    std::vector<std::pair<std::string, std::string>> names = {
        {"0.4:cd_sq", "peer/cd_sq_m2"},
        {"0.4:F22", "peer/f_score"},
        {"0.5:cd_mean", "strict/cd_mean_m"},
        {"0.5:cd_sq", "strict/cd_sq_m2"},
        {"0.5:F5", "strict/f_5cm"},
        {"0.5:F22", "strict/f_22cm"},
        {"0.5:drop_acc", "strict/drop_accuracy"},
        {"0.5:drop_f1", "strict/drop_f1"},
        {"0.4:n_dyn", "moving_boxes/pixels"},
        {"0.4:a_depth_psnr", "peer/depth_psnr_db"},
        {"0.4:a_int_psnr", "peer/intensity_psnr_db"},
        {"0.5:a_depth_psnr", "strict/image_depth_psnr_db"}};
    for (const char* region : {"edges", "smooth"})
        for (const char* score : {"pixels", "share", "returned", "above_1m", "depth_medae_m", "cd_mean_m",
                                  "cd_sq_m2", "f_5cm", "f_22cm"})
            names.emplace_back(fmt::format("{}/{}", region, score), fmt::format("{}/{}", region, score));
    for (const char* error : {"rmse", "mae", "medae"}) {
        for (const auto& [theirs, ours] : {std::pair("0.4:a", "peer/"),
                                           {"0.5:a", "strict/image_"},
                                           {"0.5:c", "strict/"},
                                           {"0.4:b", "all/"}}) {
            names.emplace_back(fmt::format("{}_depth_{}", theirs, error),
                               fmt::format("{}depth_{}_m", ours, error));
            names.emplace_back(fmt::format("{}_int_{}", theirs, error),
                               fmt::format("{}intensity_{}", ours, error));
        }
        names.emplace_back(fmt::format("0.4:dyn_depth_{}", error),
                           fmt::format("moving_boxes/depth_{}_m", error));
        names.emplace_back(fmt::format("0.4:static_depth_{}", error),
                           fmt::format("static/depth_{}_m", error));
    }
    for (const auto& [theirs, ours] : names) {
        ASSERT_TRUE(expected.contains(theirs)) << theirs;
        ASSERT_TRUE(actual_metrics.contains(ours)) << ours;
        EXPECT_NEAR(actual_metrics.at(ours), expected.at(theirs),
                    1e-6 * (1.0 + std::abs(expected.at(theirs))))
            << theirs << " " << ours;
    }
}

}  // namespace
}  // namespace relidar
