// SPDX-License-Identifier: Apache-2.0
// Trains and evaluates the ray-drop network. The network must learn a rule that depends
// on neighbouring pixels.
#include <cmath>
#include <limits>
#include <random>

#include <gmock/gmock.h>

#include <relidar/base/error.hpp>
#include <relidar/diff/network.hpp>

#include "../../support/device.hpp"
#include "support/names.hpp"

namespace relidar {
namespace {

using test::Names;

class DropNetworkTest : public test::DeviceTest {};

/// Makes an image with random intensities in which a ray is dropped if its right
/// neighbour is dark. The rendered logit is 0.3 everywhere.
RayDropImage make_dark_neighbours(int rows, int columns, const RayDropNetworkOptions& options,
                                  std::uint64_t seed) {
    std::mt19937_64 random(seed);
    const std::vector<std::string> names = channel_names(options);
    const std::size_t n = std::size_t(rows) * std::size_t(columns);
    RayDropImage image{rows, columns, std::vector<float>(names.size() * n, 0.0f), std::vector<float>(n)};
    float* intensity = image.channels.data() + n;
    for (std::size_t i = 0; i < n; ++i) {
        image.channels[i] = float(random() % 100) * 0.01f;
        intensity[i] = float(random() % 100) * 0.01f;
        image.channels[2 * n + i] = 0.3f;
    }
    for (std::size_t i = 0; i < n; ++i) {
        const std::size_t row = i / std::size_t(columns),
                          right = row * std::size_t(columns) + (i + 1) % std::size_t(columns);
        image.dropped[i] = intensity[right] < 0.3f ? 1.0f : 0.0f;
    }
    return image;
}

std::vector<RayDropImage> make_some_images(const RayDropNetworkOptions& options, std::size_t count,
                                           int rows = 16, int columns = 40) {
    std::vector<RayDropImage> images;
    for (std::size_t i = 0; i < count; ++i)
        images.push_back(make_dark_neighbours(rows, columns, options, 20 + i));
    return images;
}

double compute_accuracy(const std::vector<float>& probability, const RayDropImage& image) {
    double right = 0.0;
    for (std::size_t i = 0; i < probability.size(); ++i)
        right += (probability[i] > 0.5f) == (image.dropped[i] > 0.5f);
    return right / double(probability.size());
}

RayDropNetworkOptions make_short_training() {
    const RayDropNetworkOptions options{.levels = 1, .epochs = 40, .batch = 2, .rate = 0.02};
    return options;
}

TEST_F(DropNetworkTest, LearnsWhatNeighboursSay) {
    RayDropNetworkOptions options = make_short_training();
    options.epochs = 20;
    const RayDropNetwork network =
        train_drop_network(device(), make_some_images(options, 32), options, 1, {});
    RayDropRefiner refiner(device(), network);
    const RayDropImage untrained_image = make_dark_neighbours(16, 40, options, 99),
                       larger = make_dark_neighbours(25, 61, options, 98);
    // always predicting a return would reach 0.7
    EXPECT_GT(compute_accuracy(refiner.predict_drops(untrained_image), untrained_image), 0.97);
    EXPECT_GT(compute_accuracy(refiner.predict_drops(larger), larger), 0.97);
    EXPECT_EQ(refiner.predict_drops(larger), refiner.predict_drops(larger));
    // more shapes than the network caches
    const RayDropImage shapes[] = {untrained_image, larger, make_dark_neighbours(20, 50, options, 97)};
    for (const int which : {0, 1, 0, 2, 1, 2, 0})
        EXPECT_EQ(refiner.predict_drops(shapes[which]),
                  RayDropRefiner(device(), network).predict_drops(shapes[which]))
            << which;
}

/// Only in a full turn is the first column a neighbour of the last column.
TEST_F(DropNetworkTest, ColumnsAreNeighboursOnlyInAFullTurn) {
    RayDropNetworkOptions options = make_short_training();
    options.epochs = 5;
    for (const bool circular : {true, false}) {
        std::vector<RayDropImage> images = make_some_images(options, 4);
        for (RayDropImage& image : images) image.circular = circular;
        RayDropRefiner refiner(device(), train_drop_network(device(), images, options, 1, {}));
        const std::vector<float> before = refiner.predict_drops(images[0]);
        for (std::size_t row = 0; row < 16; ++row) images[0].channels[(16 + row) * 40] += 1.0f;
        const std::vector<float> after = refiner.predict_drops(images[0]);
        std::size_t n_changed = 0;
        for (std::size_t i = 0; i < before.size(); ++i) n_changed += i % 40 >= 30 && before[i] != after[i];
        EXPECT_EQ(n_changed > 0, circular);
        EXPECT_NE(before[0], after[0]);
    }
}

TEST_F(DropNetworkTest, PixelsByThemselvesCannotKnow) {
    RayDropNetworkOptions options = make_short_training();
    options.network = "pixel";
    options.levels = -1;
    const RayDropNetwork network = train_drop_network(device(), make_some_images(options, 4), options, 1, {});
    const RayDropImage image = make_dark_neighbours(16, 40, options, 99);
    EXPECT_LT(compute_accuracy(RayDropRefiner(device(), network).predict_drops(image), image), 0.8);
}

TEST_F(DropNetworkTest, SameSeedGivesTheSameBitsAnotherDoesNot) {
    RayDropNetworkOptions options = make_short_training();
    options.epochs = 2;
    options.network = "paper";  // the paper's network uses dropout
    options.width = 8;
    const std::vector<RayDropImage> images = make_some_images(options, 4);
    const RayDropNetwork a = train_drop_network(device(), images, options, 1, {}),
                         b = train_drop_network(device(), images, options, 1, {}),
                         c = train_drop_network(device(), images, options, 2, {});
    EXPECT_EQ(a.parameters, b.parameters);
    EXPECT_EQ(a.running, b.running);
    EXPECT_NE(a.parameters, c.parameters);
}

TEST_F(DropNetworkTest, StartsAsTheRenderingItself) {
    RayDropNetworkOptions options = make_short_training();
    options.epochs = 1;
    options.rate = 1e-12;
    const RayDropNetwork network = train_drop_network(device(), make_some_images(options, 2), options, 1, {});
    for (const float p :
         RayDropRefiner(device(), network).predict_drops(make_dark_neighbours(16, 40, options, 5)))
        EXPECT_NEAR(p, 1.0 / (1.0 + std::exp(-0.3)), 1e-5);
}

TEST_F(DropNetworkTest, PixelsThatAreNotKnownDoNotCount) {
    RayDropNetworkOptions options = make_short_training();
    options.epochs = 1;
    std::vector<RayDropImage> images = make_some_images(options, 2), blinded = images;
    for (std::size_t i = 0; i < 100; ++i) {
        images[0].dropped[i] = images[1].dropped[i] = -1.0f;
        blinded[0].dropped[i] = blinded[1].dropped[i] = -3.0f;
    }
    EXPECT_EQ(train_drop_network(device(), images, options, 1, {}).parameters,
              train_drop_network(device(), blinded, options, 1, {}).parameters);
}

TEST_F(DropNetworkTest, StopsWhereProgressSaysSo) {
    const RayDropNetworkOptions options = make_short_training();
    int steps = 0;
    const auto three = [&](const RayDropTrainProgress& p, const auto&) {
        EXPECT_EQ(p.step, ++steps);
        EXPECT_EQ(p.n_steps, 80);
        return steps < 3;
    };
    const RayDropNetwork network =
        train_drop_network(device(), make_some_images(options, 4), options, 1, three);
    EXPECT_EQ(steps, 3);
    EXPECT_FALSE(network.empty());
}

RayDropTrainState train_for_steps(Device& device, const std::vector<RayDropImage>& images,
                                  const RayDropNetworkOptions& options, int step,
                                  const RayDropTrainState* start = nullptr) {
    RayDropTrainState saved_state;
    train_drop_network(
        device, images, options, 1,
        [&](const RayDropTrainProgress& p, const std::function<RayDropTrainState()>& state) {
            if (p.step == step) saved_state = state();
            return p.step < step;
        },
        start);
    return saved_state;
}

TEST_F(DropNetworkTest, GoesOnWithTheSameBits) {
    for (const char* name : {"small", "paper"}) {
        RayDropNetworkOptions options = make_short_training();
        options.network = name;
        options.width = 8;
        options.rays = "origin,direction";
        options.epochs = 4;
        const std::vector<RayDropImage> images = make_some_images(options, 6);
        std::vector<RayDropTrainProgress> uninterrupted, parts;
        const auto collect_into = [](std::vector<RayDropTrainProgress>& lines) {
            return [&](const RayDropTrainProgress& p, const auto&) {
                lines.push_back(p);
                return true;
            };
        };
        const RayDropNetwork expected =
            train_drop_network(device(), images, options, 1, collect_into(uninterrupted));
        ASSERT_EQ(uninterrupted.size(), 12u);
        const RayDropTrainState in_an_epoch = train_for_steps(device(), images, options, 4),
                                at_its_end = train_for_steps(device(), images, options, 6, &in_an_epoch);
        EXPECT_EQ(at_its_end.step, 6);
        EXPECT_GE(at_its_end.seconds, in_an_epoch.seconds);
        const RayDropNetwork resumed =
            train_drop_network(device(), images, options, 1, collect_into(parts), &at_its_end);
        EXPECT_EQ(resumed.parameters, expected.parameters) << name;
        EXPECT_EQ(resumed.running, expected.running) << name;
        EXPECT_EQ(resumed.normalisation, expected.normalisation) << name;
        ASSERT_EQ(parts.size(), 6u);
        for (std::size_t i = 0; i < parts.size(); ++i) {
            EXPECT_EQ(parts[i].step, uninterrupted[i + 6].step);
            EXPECT_EQ(parts[i].epoch, uninterrupted[i + 6].epoch);
            EXPECT_EQ(parts[i].entropy, uninterrupted[i + 6].entropy);
        }
        const RayDropTrainState all = train_for_steps(device(), images, options, 12, &in_an_epoch);
        EXPECT_EQ(train_drop_network(device(), images, options, 1, collect_into(parts), &all).parameters,
                  expected.parameters);
        EXPECT_EQ(parts.size(), 6u) << "nothing was left to do";
        options.epochs = 1;
        EXPECT_THROW(train_drop_network(device(), images, options, 1, {}, &in_an_epoch), DataError)
            << "4 steps of 3";
        options.epochs = 4;
        options.width = 16;
        EXPECT_THROW(train_drop_network(device(), images, options, 1, {}, &in_an_epoch), DataError)
            << "of another network";
    }
}

TEST_F(DropNetworkTest, RefusesWhatItCannotWorkWith) {
    const auto message = [&](const std::vector<RayDropImage>& images,
                             const RayDropNetworkOptions& options) -> std::string {
        try {
            train_drop_network(device(), images, options, 1, {});
        } catch (const Error& error) {
            return error.what();
        }
        return "";
    };
    RayDropNetworkOptions options = make_short_training();
    options.levels = 3;
    EXPECT_THAT(message(make_some_images(options, 1, 6, 40), options), Names("6 x 40 pixels ... 8 x 8"));
    EXPECT_THAT(message({}, options), Names("training"));
    std::vector<RayDropImage> images = make_some_images(options, 2);
    images[1].channels[16 * 40 + 45] = std::numeric_limits<float>::quiet_NaN();
    EXPECT_THAT(message(images, options), Names("intensity ... row 1 ... column 5 ... nan"));
    images = make_some_images(options, 2);
    for (RayDropImage& image : images) std::fill(image.dropped.begin(), image.dropped.end(), 0.0f);
    EXPECT_THAT(message(images, options), Names("dropped"));
    images = make_some_images(options, 1);
    images.push_back(make_dark_neighbours(16, 41, options, 3));
    EXPECT_THAT(message(images, options), Names("image 1 ... 16 x 41 ... 16 x 40"));
    images = make_some_images(options, 1);
    images[0].dropped.clear();
    EXPECT_THAT(message(images, options), Names("measured"));
}

TEST_F(DropNetworkTest, RefusesWeightsOfAnotherConfiguration) {
    RayDropNetworkOptions options = make_short_training();
    options.epochs = 1;
    RayDropNetwork network = train_drop_network(device(), make_some_images(options, 2), options, 1, {});
    network.widths[0] += 1;
    EXPECT_THAT([&] { RayDropRefiner(device(), network); },
                testing::ThrowsMessage<DataError>(Names("parameters")));
    network.widths[0] -= 1;
    RayDropRefiner refiner(device(), network);
    EXPECT_THAT(
        [&] {
            refiner.predict_drops({16, 40, std::vector<float>(16 * 40), {}});
        },
        testing::ThrowsMessage<DataError>(Names("channel")));
}

TEST(DropNetworkShape, PaperHasAbout65MillionParameters) {
    const RayDropNetworkOptions options{.network = "paper", .rays = "origin,direction"};
    // Channels: depth, intensity, drop probability, origin (3), and the elevation of the
    // direction.
    EXPECT_EQ(channel_names(options).size(), 7u);
    EXPECT_NEAR(double(count_parameters(options)), 6.5e6, 0.1e6);
}

}  // namespace
}  // namespace relidar
