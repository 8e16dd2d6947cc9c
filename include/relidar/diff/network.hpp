// SPDX-License-Identifier: Apache-2.0
// Ray-drop network: looks at a complete rendered scan and corrects the drop probability
// of each ray (paper, section 3.5, Eq. 12-13). Surfels model what a surface returns. The
// network models what the sensor makes of it (glass, dark paint, grazing beams,
// electronics), which shows in the image.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <relidar/gpu/device.hpp>

namespace relidar {

/// Options of the ray-drop network and its training: config.refine.
struct RefineOptions {
    /// If true, training ends with the training of the network, and rendering uses the
    /// network of a run that has one.
    bool enabled = false;
    /// "small", "paper" or "pixel" (each pixel is processed separately). "paper" has 6.5
    /// million parameters. Its training uses a dropout of 0.1 and rotates images around
    /// the sensor by a random number of columns.
    std::string network = "small";
    int width = 0;    ///< Channels at full resolution; 0 = default of the network.
    int levels = -1;  ///< Number of times that the image is halved; -1 = default of the network.
    /// Input image: "native" (the rays of the sensor) or "grid" (the cells of
    /// config.sensor.grid).
    std::string image = "native";
    /// Inputs about the rays: "none", "direction" (its elevation) or "origin,direction".
    std::string rays = "direction";
    int frames = 64;     ///< Maximum number of training frames, spread evenly over the log; 0 = all.
    int epochs = 4;      ///< Number of times that each training frame is used.
    int batch = 0;       ///< Images per training step; 0 = default of the network.
    double rate = 2e-3;  ///< Initial learning rate of Adam; it decreases to a hundredth.
    bool operator==(const RefineOptions&) const = default;
};

/// Network input for a scan in image order, and the measured drops.
struct DropImage {
    int rows = 0, columns = 0;
    /// Input channels, [channels of the network, rows, columns]; drop_channel_names()
    /// lists them.
    std::vector<float> channels;
    /// Measured drops, [rows, columns]: 1 dropped, 0 returned, negative = unknown. Empty
    /// if nothing was measured.
    std::vector<float> dropped;
};

/// Returns the names of the network's channels in order: "log_range", "intensity",
/// "drop_logit", "weight", "spread", "cosine" (of incidence). Then follow channels that
/// belong to the pixels of the sensor: "elevation" (its sine, in the sensor frame) and
/// "origin_x" ... "origin_z".
std::vector<std::string> drop_channel_names(const RefineOptions& options);

/// Trained ray-drop network.
struct DropNetwork {
    std::string image = "native";       ///< Image type of the training: "native", or the name of a grid.
    std::vector<std::string> inputs;    ///< Names of the input channels.
    std::vector<std::uint32_t> widths;  ///< Channels at each resolution: full size, half, ...
    std::uint32_t heads = 0;            ///< Attention heads at the smallest resolution; 0 = no attention.
    std::uint32_t taps = 9;  ///< Taps of the convolutions: 9, or 1 if each pixel is processed separately.
    /// If true, the output is added to the rendered logit; otherwise it replaces the
    /// rendered logit.
    bool residual = true;
    std::vector<float> normalisation;  ///< Scale and shift of each input channel, [channels, 2].
    std::vector<float> parameters;     ///< Parameters layer by layer, in the order of evaluation.
    std::vector<float> running;        ///< Running moments of the normalisation layers, for evaluation.

    bool empty() const { return parameters.empty(); }
    /// Returns the minimum number of rows and columns of an image.
    int smallest_side() const { return 1 << (widths.empty() ? 0 : widths.size() - 1); }
};

/// Returns the number of trainable parameters of the network that the options describe.
std::size_t count_parameters(const RefineOptions& options);

/// Progress of the training of a ray-drop network.
struct RefineProgress {
    int epoch = 0, n_epochs = 0;
    int step = 0, n_steps = 0;
    double entropy = 0.0;  ///< Mean cross-entropy of the pixels in this epoch so far.
    /// Share of pixels in this epoch for which the more likely answer was correct.
    double accuracy = 0.0;
    double seconds = 0.0;
};

/// State of a training after a step. With the same images, options and seed, training
/// resumes exactly from this state.
struct RefineState {
    int step = 0;                         ///< Number of the last completed step.
    std::vector<float> parameters;        ///< Network parameters, [parameters], as in DropNetwork.
    std::vector<float> moment1, moment2;  ///< Adam moments, [parameters].
    std::vector<float> running;           ///< Running moments of the normalisation layers, as in DropNetwork.
    double entropy = 0.0, accuracy = 0.0;  ///< Sums over the steps of the current epoch.
    double seconds = 0.0;                  ///< Seconds of training so far.

    /// Calls visit(name, value) for each value that a checkpoint stores.
    template <class Visitor>
    void visit_state(Visitor&& visit) {
        visit("step", step);
        visit("parameters", parameters);
        visit("moment1", moment1);
        visit("moment2", moment2);
        visit("running", running);
        visit("entropy", entropy);
        visit("accuracy", accuracy);
        visit("seconds", seconds);
    }
};

/// Callback after each training step.
/// @param state copies the state from the device
/// @return false to stop training and return the current network
using RefineCallback =
    std::function<bool(const RefineProgress& progress, const std::function<RefineState()>& state)>;

/// Trains a network on images of equal shape. The same seed gives a bit-identical network
/// on the same device.
/// @param start state to resume from, of a training with the same images, options and
/// seed; null = start from the beginning
/// @throws DataError if the images have different shapes, are too small, have values that
/// are not finite, or have no dropped pixels
/// @throws DataError if `start` belongs to another network or has more steps than the
/// training
/// @throws DeviceError if the device cannot run the layers of the network
DropNetwork train_drop_network(Device& device, const std::vector<DropImage>& images,
                               const RefineOptions& options, std::uint64_t seed,
                               const RefineCallback& progress, const RefineState* start = nullptr);

class DropPass;

/// Network in evaluation mode: equal images give equal results.
class DropRefiner {
public:
    /// Uploads the network.
    /// @throws DataError if the arrays do not match the shape of the network
    /// @throws DeviceError as train_drop_network()
    DropRefiner(Device& device, const DropNetwork& network);
    ~DropRefiner();
    DropRefiner(DropRefiner&&) noexcept;
    DropRefiner& operator=(DropRefiner&&) noexcept;

    const DropNetwork& network() const;
    /// Returns the drop probability of each pixel, [rows, columns].
    /// @throws DataError as train_drop_network()
    std::vector<float> refine(const DropImage& image);
    /// Returns the kernel times so far in milliseconds, by kernel name, if the device has
    /// timestamps.
    const KernelTimes& times() const;
    /// Returns the network for images that are already on the device
    /// (<relidar/diff/network_training.hpp>).
    DropPass& pass();

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
