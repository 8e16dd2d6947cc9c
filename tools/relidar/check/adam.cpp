// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include <relidar/diff/optimizer.hpp>
#include "check/checks.hpp"

namespace relidar::cli {

/// Runs three steps of the Adam optimizer on the device and, in double precision, on the
/// CPU. The values may differ by at most 1e-6.
CheckResult check_adam(CheckedDevice& tested) {
    constexpr std::size_t kAdamValues = 1000;
    constexpr double kLearningRate = 1e-2;
    const AdamOptions options;
    std::mt19937 random(3);
    std::normal_distribution<float> normal;
    std::vector<float> start(kAdamValues), gradient(kAdamValues);
    for (float& x : start) x = normal(random);
    // The values and both moments of Adam (Kingma and Ba 2015) on the CPU.
    std::vector<double> expected(start.begin(), start.end()), m(kAdamValues, 0.0), v(kAdamValues, 0.0);
    Device& device = tested.default_device();
    ArrayAdam adam(device, kAdamValues, options);
    const Array<float> values(device, std::span<const float>(start), "values");
    Array<float> gradients(device, kAdamValues, "gradients");
    Stream stream(device);
    for (int step = 1; step <= 3; ++step) {
        for (float& x : gradient) x = normal(random);
        gradients.upload(gradient);
        adam.record_step(stream, values, gradients, kLearningRate, step);
        stream.submit_and_wait();
        for (std::size_t i = 0; i < kAdamValues; ++i) {
            const double g = gradient[i];
            m[i] = options.beta1 * m[i] + (1.0 - options.beta1) * g;
            v[i] = options.beta2 * v[i] + (1.0 - options.beta2) * g * g;
            const double m_hat = m[i] / (1.0 - std::pow(options.beta1, step)),
                         v_hat = v[i] / (1.0 - std::pow(options.beta2, step));
            expected[i] -= kLearningRate * m_hat / (std::sqrt(v_hat) + options.epsilon);
        }
    }
    const std::vector<float> actual = values.download();
    double error = 0.0;
    for (std::size_t i = 0; i < kAdamValues; ++i) {
        const double difference = std::abs(actual[i] - expected[i]);
        error = std::isfinite(difference) ? std::max(error, difference) : HUGE_VAL;
    }
    return compare_error(error, 1e-6);
}

}  // namespace relidar::cli
