// SPDX-License-Identifier: Apache-2.0
#include <relidar/run/stage_options.hpp>

#include <array>
#include <set>

#include <fmt/format.h>

#include <relidar/diff/backward.hpp>
#include <relidar/diff/traversal.hpp>
#include <relidar/log/channels.hpp>

#include "../../base/codecs/temporary_folder.hpp"
#include "support/names.hpp"

namespace relidar {
namespace {

using ConfigFile = TemporaryFolder;

std::string set_error(const std::string& key, const std::string& value) {
    return error_message<UsageError>([&] {
        Config config;
        set_value(config, key, value);
    });
}

std::string value_of(const Config& config, const std::string& key) {
    for (const ConfigKey& entry : list_config_keys(config))
        if (entry.key == key) return entry.value;
    ADD_FAILURE() << "no key " << key;
    return "";
}

void expect_equal(const Config& first, const Config& second) {
    const std::vector<ConfigKey> x = list_config_keys(first), y = list_config_keys(second);
    ASSERT_EQ(x.size(), y.size());
    for (std::size_t i = 0; i < x.size(); ++i) EXPECT_EQ(x[i].value, y[i].value) << x[i].key;
}

Config convert_through_toml(const Config& config, const std::filesystem::path& folder) {
    put(folder / "config.toml", to_toml(config));
    Config result;
    apply_file(result, folder / "config.toml");
    return result;
}

bool change(Config& config, const std::string& key) {
    const std::string before = value_of(config, key);
    for (const char* value : {"0.12345678",
                              "seen",
                              "0.6000001",
                              "0.25",
                              "2",
                              "7",
                              "123456",
                              "true",
                              "false",
                              "kitti360",
                              "cast",
                              "ray",
                              "surfel",
                              "median",
                              "expected",
                              "gaussian",
                              "adaptive",
                              "pixel",
                              "direction",
                              "grid",
                              "sensor",
                              "none",
                              "removed",
                              "range",
                              "clamp",
                              "raw",
                              "ms",
                              "clock",
                              "sensor_from_world",
                              "xyzw",
                              "degrees",
                              "lowest_first",
                              "bottom",
                              "turned",
                              "a \"b\" \\c"}) {
        if (value == before) continue;
        try {
            set_value(config, key, value);
            return true;
        } catch (const UsageError&) {}
    }
    return false;
}

TEST_F(ConfigFile, PresetsRoundTrip) {
    for (const char* name : {"paper", "released", "default", "quick"}) {
        const Config config = make_preset(name);
        EXPECT_EQ(config.preset, name);
        EXPECT_TRUE(convert_through_toml(config, folder) == config);
    }
}

TEST_F(ConfigFile, EveryKeyRoundTrips) {
    const Config defaults = make_preset("default");
    Config all = defaults;
    for (const ConfigKey& entry : list_config_keys(defaults)) {
        if (entry.key == "preset") continue;
        Config one = defaults;
        ASSERT_TRUE(change(one, entry.key)) << entry.key << " takes no other value";
        EXPECT_NE(value_of(one, entry.key), entry.value) << entry.key;
        expect_equal(one, convert_through_toml(one, folder));
        change(all, entry.key);
    }
    expect_equal(all, convert_through_toml(all, folder));
}

TEST_F(ConfigFile, ValuesReadBackBitByBit) {
    Config config;
    config.loss.depth = 0.1f / 3.0f;
    config.refine.rate = 1.6e-4 / 7.0;
    config.train.seed = 9007199254740991u;
    const Config read = convert_through_toml(config, folder);
    EXPECT_EQ(read.loss.depth, config.loss.depth);
    EXPECT_EQ(read.refine.rate, config.refine.rate);
    EXPECT_EQ(read.train.seed, config.train.seed);
}

TEST_F(ConfigFile, SavedFilesHaveEverySettingAndNoOther) {
    const std::string full_toml = to_toml(make_preset("quick"));
    const auto error = [&](const std::string& text) {
        put(folder / "config.toml", text);
        return get_data_error_message([&] { load_settings(folder / "config.toml"); });
    };
    put(folder / "config.toml", full_toml);
    expect_equal(load_settings(folder / "config.toml"), make_preset("quick"));
    const std::string file = (folder / "config.toml").string() + ": ";
    EXPECT_THAT(error(full_toml + "[mars]\ncolour = \"red\"\n"),
                test::Names(file + "... mars.colour ... `relidar list settings --all`"));
    const std::string line = "alpha_min = 0.04\n";
    std::string less = full_toml;
    ASSERT_NE(less.find(line), std::string::npos);
    EXPECT_THAT(error(less.erase(less.find(line), line.size())),
                test::Names(file + "... image.alpha_min ... missing"));
    EXPECT_THAT(error(full_toml.substr(0, full_toml.find("preset = ")) +
                      full_toml.substr(full_toml.find("[dataset]"))),
                test::Names(file + "... preset"));
    std::string changed = full_toml;
    const std::string quoted = "rolling_shutter = \"auto\"";
    ASSERT_NE(changed.find(quoted), std::string::npos);
    EXPECT_THAT(
        error(changed.replace(changed.find(quoted), quoted.size(), "rolling_shutter = true")),
        test::Names(file + "... sensor.rolling_shutter ... \"true\" ... auto, true, false ... quotes"));
}

TEST_F(ConfigFile, ShortFormReadsBackToTheSame) {
    for (const char* name : {"paper", "quick"}) {
        Config config = make_preset(name);
        config.loss.box = 0.25f;
        config.train.iterations = 17;
        put(folder / "short.toml", to_short_toml(config));
        Config read;
        apply_file(read, folder / "short.toml");
        expect_equal(read, config);
        EXPECT_EQ(to_short_toml(config).find("keep_hits"), std::string::npos);
        EXPECT_LT(to_short_toml(config).size(), to_toml(config).size() / 2 + 2000);
    }
}

TEST(Config, ChannelsAreAList) {
    Config config;
    set_value(config, "render.channels", "normal, seen");
    EXPECT_EQ(parse_channels(config.render.channels).size(), 2u);
    set_value(config, "render.channels", "");
    EXPECT_THAT(set_error("render.channels", "normal,sean"), test::Names("\"normal,sean\""));
}

TEST(Config, KeysAreUniqueAndExplained) {
    std::set<std::string> unique_keys;
    std::size_t n_conventions = 0;  // `relidar info` names the one that a log needs
    for (const ConfigKey& entry : list_config_keys(Config{})) {
        n_conventions += entry.key.starts_with("conventions.");
        EXPECT_TRUE(unique_keys.insert(entry.key).second) << entry.key << " twice";
        EXPECT_GT(entry.help.size(), 10u) << entry.key;
        if (entry.key == "preset") continue;
        Config config;
        EXPECT_NO_THROW(set_value(config, entry.key, entry.value));
    }
    EXPECT_GT(unique_keys.size(), 45u);
    EXPECT_LE(unique_keys.size() - n_conventions, 80u)
        << "each costs its reader a minute: one that nobody turns is a constant of the code";
}

TEST(Config, UnknownKeyNamesTheNearest) {
    EXPECT_THAT(set_error("loss.dept", "1"), test::Names("loss.dept: unknown ... loss.depth"));
    EXPECT_THAT(set_error("train.iteration", "1"),
                test::Names("train.iteration: unknown ... train.iterations"));
    EXPECT_THAT(set_error("", "1"), test::Names("unknown"));
    // constants of the presets are not settings
    for (const char* key : {"train.mean_rate", "init.flatness", "densify.from", "refine.batch"})
        EXPECT_THAT(set_error(key, "1"), test::Names(key + std::string(": unknown")));
}

TEST(Config, BadValuesGetOneClearLine) {
    for (const auto& [key, value, expected] :
         std::vector<std::array<const char*, 3>>{{"loss.depth", "abc", "0"},
                                                 {"loss.depth", "-0.1", "0"},
                                                 {"loss.depth", "nan", "0"},
                                                 {"loss.depth", "inf", "0"},
                                                 {"loss.depth", "1e99", "0"},
                                                 {"loss.depth", "", "0"},
                                                 {"loss.depth", "0.1 ", "0"},
                                                 {"train.iterations", "1.5", "integer ... 0"},
                                                 {"train.iterations", "99999999999", "integer ... 0"},
                                                 {"trace.chunk", "65", "integer ... 1 ... 64"},
                                                 {"init.voxel_m", "0", "above 0"},
                                                 {"init.normals", "yes", "true ... false"},
                                                 {"image.sh_direction", "hit", "ray, surfel"},
                                                 {"train.seed", "-1", "integer ... 0"}})
        EXPECT_THAT(set_error(key, value),
                    test::Names(fmt::format("setting {} ... \"{}\" ... {}", key, value, expected)));
    EXPECT_THAT(set_error("dataset.poses", "a\nb"), test::Names("dataset.poses ... text"));
}

TEST(Config, PresetReplacesEverythingAndAFailureNothing) {
    Config config;
    EXPECT_THROW(set_value(config, "image.sh_degree", "9"), UsageError);
    expect_equal(config, Config{});
    set_value(config, "loss.depth", "5");
    set_value(config, "preset", "paper");
    expect_equal(config, make_preset("paper"));
    EXPECT_THAT(error_message<UsageError>([] { make_preset("papr"); }), test::Names("'paper'"));
}

TEST(Config, PaperIsThePaper) {
    const Config c = make_preset("paper");
    EXPECT_EQ(c.train.iterations, 30000);
    EXPECT_EQ(c.train.rays_per_iteration, 0);
    EXPECT_EQ(c.train.sh_degree_interval, 1000);
    EXPECT_EQ(c.train.mean_rate, 1.6e-4);
    EXPECT_EQ(c.train.mean_rate_final, 1.6e-6);
    EXPECT_EQ(c.train.rate_decay, 1.0);
    EXPECT_EQ(c.init.voxel_m, 0.15);
    EXPECT_EQ(c.init.voxel_growth, 0.0);
    EXPECT_EQ(c.init.normal_neighbours, 6);
    EXPECT_EQ(c.init.opacity, 0.1);
    EXPECT_EQ(c.loss.depth, 0.1f);
    EXPECT_EQ(c.loss.drop, 0.01f);
    EXPECT_EQ(c.loss.intensity, 0.1f);
    EXPECT_EQ(c.loss.intensity_ssim, 0.0f);
    EXPECT_EQ(c.loss.chamfer, 0.01f);
    EXPECT_EQ(c.loss.box + c.loss.opacity + c.loss.likelihood, 0.0f);
    EXPECT_FALSE(c.loss.normalised_depth);
    EXPECT_EQ(c.image.sh_direction, ShDirection::ray);
    EXPECT_EQ(c.render.range, "expected");
    EXPECT_EQ(common_options(c).chunk, 16);
    EXPECT_EQ(c.densify.strategy, DensifyStrategy::adaptive);
    EXPECT_EQ(c.densify.gradient_threshold, 2e-4);
    EXPECT_EQ(c.densify.clone_extent_share, 2e-4);
    EXPECT_EQ(c.densify.until, 15000);
    EXPECT_EQ(make_preset("default").densify.strategy, DensifyStrategy::none);
}

/// docs/method.md section 5
TEST(Config, ReleasedDiffersFromThePaperInThreeLosses) {
    Config c = make_preset("released");
    EXPECT_EQ(c.loss.intensity_ssim, 0.15f);
    EXPECT_EQ(c.loss.chamfer, 0.0f);
    EXPECT_EQ(c.loss.box, 0.01f);
    EXPECT_EQ(c.train.rays_per_iteration, 0) << "structural similarity is of images";
    const Config paper = make_preset("paper");
    c.preset = paper.preset;
    c.loss.intensity_ssim = paper.loss.intensity_ssim;
    c.loss.chamfer = paper.loss.chamfer;
    c.loss.box = paper.loss.box;
    expect_equal(c, paper);
}

TEST(Config, EnumFieldsReachTheirStages) {
    Config config;
    EXPECT_EQ(backward_options(config).reduction, GradientReduction::automatic);
    set_value(config, "train.deterministic", "true");
    EXPECT_EQ(backward_options(config).reduction, GradientReduction::gather);
    set_value(config, "trace.chunk", "8");
    EXPECT_EQ(common_options(config).chunk, 8);
}

TEST(Config, LossesReachTheTraceOfTraining) {
    Config config;
    EXPECT_FALSE(training_options(config).likelihood);
    set_value(config, "loss.likelihood", "0.1");
    config.loss.likelihood_scale_m = 0.2f;
    const TraceOptions likelihood = training_options(config);
    EXPECT_FALSE(likelihood.writes_surfaces());
    ASSERT_TRUE(likelihood.likelihood);
    EXPECT_EQ(likelihood.likelihood->scale_m, 0.2f);
    EXPECT_TRUE(rendering_options(config).normals);
    set_value(config, "image.primitive", "gaussian");
    EXPECT_FALSE(rendering_options(config).writes_surfaces());
    set_value(config, "render.range", "mode");
    set_value(config, "sensor.return_separation_m", "0.7");
    EXPECT_EQ(rendering_options(config).mode_gap_m, 0.7f);
    EXPECT_FALSE(training_options(config).mode_gap_m);
}

TEST_F(ConfigFile, BadFilesNameFileAndKey) {
    const auto error = [&](const std::string& text) {
        put(folder / "c.toml", text);
        return error_message<UsageError>([&] {
            Config config;
            apply_file(config, folder / "c.toml");
        });
    };
    const std::string file = (folder / "c.toml").string() + ": ";
    EXPECT_THAT(error("[loss]\ndpth = 1\n"), test::Names(file + "setting loss.dpth: unknown ... loss.depth"));
    EXPECT_THAT(error("[loss]\ndepth = nan\n"), test::Names(file + "... loss.depth ... \"nan\" ... 0"));
    EXPECT_THAT(error("[loss]\ndepth = \"0.1\"\n"),
                test::Names(file + "... loss.depth ... \"0.1\" ... quotes"));
    EXPECT_THAT(error("[sensor]\ngrid = 360\n"),
                test::Names(file + "... sensor.grid ... \"360\" ... kitti360 ... quotes"));
    EXPECT_THAT(error("[loss]\ndepth = [1, 2]\n"), test::Names(file + "... loss.depth ... array"));
    EXPECT_THAT(error("loss = 1\n"), test::Names(file + "... loss: ... loss.box"));
    EXPECT_THAT(error("[\"lo\\nss\"]\ndepth = 1\n"), test::Names("unknown"));
}

TEST_F(ConfigFile, DamagedFilesAreDataErrors) {
    Config config;
    put(folder / "c.toml", "[loss]\ndepth = \n");
    const std::string message = get_data_error_message([&] { apply_file(config, folder / "c.toml"); });
    EXPECT_THAT(message, test::Names("c.toml:2 ... TOML"));
    std::string dots = "loss";
    for (int i = 0; i < 40000; ++i) dots += ".a";
    put(folder / "c.toml", dots + " = 1\n");
    EXPECT_THAT(get_data_error_message([&] { apply_file(config, folder / "c.toml"); }),
                test::Names("c.toml:1 ... dots"));
    EXPECT_THAT(get_data_error_message([&] { apply_file(config, folder / "missing.toml"); }),
                test::Names("missing.toml"));
    EXPECT_THAT(get_data_error_message([&] { apply_file(config, folder); }), test::Names(folder.string()));
}

TEST_F(ConfigFile, FileStartsFromItsPresetAndFailsWhole) {
    Config config;
    put(folder / "c.toml", "[train]\niterations = 5\n[loss]\ndepth = 1\n");
    set_value(config, "train.seed", "42");
    apply_file(config, folder / "c.toml");
    EXPECT_EQ(config.train.iterations, 5);
    EXPECT_EQ(config.train.seed, 42u);
    put(folder / "c.toml", "preset = \"quick\"\n[train]\niterations = 6\n");
    apply_file(config, folder / "c.toml");
    Config expected = make_preset("quick");
    expected.train.iterations = 6;
    expect_equal(config, expected);
    put(folder / "c.toml", "[train]\niterations = 7\nseed = -1\n");
    EXPECT_THROW(apply_file(config, folder / "c.toml"), UsageError);
    expect_equal(config, expected);
}

}  // namespace
}  // namespace relidar
