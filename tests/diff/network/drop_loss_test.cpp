// SPDX-License-Identifier: Apache-2.0
// Compares diff/network/drop_loss with the double reference: mean, accuracy,
// probabilities and derivatives.
#include "diff/network/drop_network.hpp"

#include "../../support/device.hpp"
#include "gpu/stream.hpp"
#include "images.hpp"

namespace relidar {
namespace {

using network::RayDropLoss, network::RayDropScore;

class DropLossTest : public test::DeviceTest {};

struct Data {
    std::vector<double> logit, start, sum, target;
    std::size_t n_known_targets = 0;
};

Data make_random_data(std::size_t count) {
    std::mt19937_64 random(count);
    std::uniform_real_distribution<double> unit(0.0, 1.0);
    Data d{test::make_random_floats(count, 1, 2.0), test::make_random_floats(count, 2, 2.0), {}, {}};
    for (std::size_t i = 0; i < count; ++i) {
        if (i % 17 == 3) d.logit[i] = i % 2 ? 120.0 : -120.0;  // exp() overflows float
        d.sum.push_back(double(float(d.logit[i]) + float(d.start[i])));
        const double u = unit(random);
        double target = 0.0;
        if (u < 0.2) target = -1.0;
        else if (u < 0.5) target = 1.0;
        d.target.push_back(target);
        d.n_known_targets += d.target.back() >= 0.0;
    }
    return d;
}

TEST_F(DropLossTest, AgreesWithReference) {
    for (const std::size_t n :
         {std::size_t(1), std::size_t(7), std::size_t(1000), std::size_t(66 * 1030), std::size_t(40961)}) {
        const Data d = make_random_data(n);
        RayDropLoss loss(device(), n);
        Stream stream(device());
        const Array<float> logit = test::to_device(device(), d.logit);
        const auto start = test::to_device<shared::StartLogits>(device(), d.start);
        const auto target = test::to_device<shared::DropTargets>(device(), d.target);
        Array<float> d_logit(device(), n + 1, "gradient");  // detects writes beyond the end
        Array<float, shared::DropProbabilities> probability(device(), n + 1, "probability");
        for (const bool with_start : {true, false}) {
            const reference::DropEntropy expected =
                reference::compute_drop_entropy(with_start ? d.sum : d.logit, d.target);
            stream.fill(d_logit, 0x7fc00000u);
            stream.fill(probability, 0x7fc00000u);
            loss.record_loss(
                stream, n,
                {logit.address_as<float, shared::DropLogits>(),
                 with_start ? start.address() : Address<float, shared::StartLogits>(), target.address(),
                 d_logit.address_as<float, shared::DropLogitGradients>(), probability.address()},
                d.n_known_targets);
            stream.submit_and_wait();
            const RayDropScore score = loss.read_loss(d.n_known_targets);
            EXPECT_NEAR(score.entropy, expected.mean, 1e-5 * expected.mean);
            EXPECT_NEAR(score.accuracy, expected.accuracy, 1e-6);
            std::vector<double> gradient = test::to_doubles(d_logit), p = test::to_doubles(probability);
            EXPECT_TRUE(std::isnan(gradient.back()) && std::isnan(p.back())) << "wrote past the end";
            for (std::size_t i = 0; i < n; ++i) {
                EXPECT_NEAR(p[i], expected.probability[i], 1e-6);
                EXPECT_NEAR(gradient[i] * double(d.n_known_targets),
                            expected.d_logit[i] * double(d.n_known_targets), 1e-6);
            }
        }
    }
}

TEST_F(DropLossTest, NothingKnown) {
    const std::size_t n = 33;
    const Data d = make_random_data(n);
    RayDropLoss loss(device(), n);
    Stream stream(device());
    const Array<float> logit = test::to_device(device(), d.logit);
    const auto none = test::to_device<shared::DropTargets>(device(), std::vector<double>(n, -1.0));
    Array<float> d_logit(device(), n, "gradient");
    Array<float, shared::DropProbabilities> probability(device(), n, "probability");
    for (const bool no_target : {true, false}) {
        stream.fill(d_logit, 0x7fc00000u);
        loss.record_loss(stream, n,
                         {logit.address_as<float, shared::DropLogits>(),
                          {},
                          no_target ? Address<float, shared::DropTargets>() : none.address(),
                          d_logit.address_as<float, shared::DropLogitGradients>(),
                          probability.address()},
                         0);
        stream.submit_and_wait();
        for (const double x : test::to_doubles(d_logit)) EXPECT_EQ(x, 0.0);
        EXPECT_EQ(loss.read_loss(0).entropy, 0.0);
        EXPECT_EQ(loss.read_loss(0).accuracy, 0.0);
    }
    loss.record_loss(
        stream, n,
        {.logit = logit.address_as<float, shared::DropLogits>(), .probability = probability.address()}, 0);
    stream.submit_and_wait();
    const std::vector<double> p = test::to_doubles(probability);
    const reference::DropEntropy expected =
        reference::compute_drop_entropy(d.logit, std::vector<double>(n, -1.0));
    for (std::size_t i = 0; i < n; ++i) EXPECT_NEAR(p[i], expected.probability[i], 1e-6);
}

}  // namespace
}  // namespace relidar
