// SPDX-License-Identifier: Apache-2.0
// Ray-drop network. Its input is a complete rendered scan, and its output is a corrected
// drop probability for each ray (paper, section 3.5, Eq. 12-13). Surfels model the
// returns of surfaces. The network models sensor effects that depend on the image, for
// example glass, dark paint, grazing beams and electronics.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <relidar/gpu/device.hpp>

namespace relidar {

struct RayDropNetworkOptions {
    /// If true, the network is trained after the surfels. Rendering uses the network if
    /// the run has one.
    bool enabled = false;
    /// Architecture: "small", "paper" or "pixel". "paper" has 6.5 million parameters. Its
    /// training uses a dropout of 0.1, and rotates each image around the sensor by a
    /// random number of columns. "pixel" processes each pixel separately.
    std::string network = "small";
    int width = 0;  ///< Number of feature channels at full resolution. 0 = default of the architecture.
    /// Number of times that the network halves the image size. -1 = default of the
    /// architecture.
    int levels = -1;
    /// Type of the input image. "native" has one pixel per ray of the sensor. "grid" has
    /// one pixel per cell of config.sensor.grid.
    std::string image = "native";
    /// Data of each ray that is added to the input image: "none", "direction" (only the
    /// ray's elevation), or "origin,direction" (elevation and x, y, z of the ray origin).
    std::string rays = "direction";
    int frames = 64;  ///< Maximum number of training frames, spread evenly over the log. 0 = all frames.
    int epochs = 4;   ///< Number of times that each training frame is used.
    int batch = 0;    ///< Number of images per training step. 0 = default of the architecture.
    /// Initial learning rate of Adam. During training, the rate decreases to a hundredth
    /// of this value.
    double rate = 2e-3;
    bool operator==(const RayDropNetworkOptions&) const = default;
};

/// Network input for one scan. For training, it also has the measured drops as the
/// target.
struct RayDropImage {
    int rows = 0, columns = 0;
    /// Input channels, [channels of the network, rows, columns].
    /// channel_names() returns the name of each channel.
    std::vector<float> channels;
    /// Measured drops, [rows, columns]. 1 = dropped, 0 = returned, negative = unknown.
    /// Empty if nothing was measured.
    std::vector<float> dropped;
    /// True if the columns cover a full turn, so that the first column follows the last.
    bool circular = true;
};

/// Returns the names of the network's input channels in order. The first six are
/// "log_range", "intensity", "drop_logit", "weight", "spread" and "cosine" (of the
/// incidence angle). The options can add "elevation" (the sine of the elevation in the
/// sensor frame) and "origin_x" ... "origin_z".
std::vector<std::string> channel_names(const RayDropNetworkOptions& options);

struct RayDropNetwork {
    std::string image = "native";     ///< Type of the training images: "native", or the name of a grid.
    std::vector<std::string> inputs;  ///< Names of the input channels.
    /// Number of feature channels at each resolution: full size, half size, and so on.
    std::vector<std::uint32_t> widths;
    std::uint32_t heads = 0;  ///< Number of attention heads at the smallest resolution. 0 = no attention.
    /// Number of pixels that a convolution kernel covers: 9 for 3 x 3, or 1 if each pixel
    /// is processed separately.
    std::uint32_t taps = 9;
    /// If true, the network predicts a correction that is added to the rendered drop
    /// logit. If false, its output replaces the rendered drop logit.
    bool residual = true;
    std::vector<float> normalisation;  ///< Scale and shift of each input channel, [channels, 2].
    std::vector<float> parameters;     ///< Network parameters, layer by layer, in the order of inference.
    /// Running means and variances of the normalisation layers, used during inference.
    std::vector<float> running;
    /// Added to the drop logit of rays that hit an actor, before the network reads it,
    /// [beams of the log]. Lasers differ in sensitivity, which decides whether dark paint
    /// returns. Empty = 0.
    std::vector<float> actor_logits = {};

    bool empty() const { return parameters.empty(); }
    int min_image_size() const { return 1 << (widths.empty() ? 0 : widths.size() - 1); }
};

/// Returns the number of trainable parameters of the network that the options describe.
std::size_t count_parameters(const RayDropNetworkOptions& options);

struct RayDropTrainProgress {
    int epoch = 0, n_epochs = 0;
    int step = 0, n_steps = 0;
    double entropy = 0.0;  ///< Mean cross-entropy of all pixels so far in this epoch.
    /// Fraction of pixels in this epoch for which the prediction (dropped or returned)
    /// was correct.
    double accuracy = 0.0;
    double seconds = 0.0;
};

/// State of a network training after a step. Training can resume exactly from this state
/// if images, options and seed are unchanged.
struct RayDropTrainState {
    int step = 0;                         ///< Number of the last completed step.
    std::vector<float> parameters;        ///< Network parameters, [parameters], as in RayDropNetwork.
    std::vector<float> moment1, moment2;  ///< First and second moments of Adam, [parameters].
    /// Running means and variances of the normalisation layers, as in RayDropNetwork.
    std::vector<float> running;
    /// Sums of the entropy and of the accuracy over the steps of the current epoch so
    /// far.
    double entropy = 0.0, accuracy = 0.0;
    double seconds = 0.0;  ///< Seconds of training so far.

    /// Calls visit(name, value) for each value that is stored in a checkpoint.
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

/// Function that is called after each training step.
/// @param state function that copies the training state from the device
/// @return false to stop training and return the current network
using RayDropTrainCallback = std::function<bool(const RayDropTrainProgress& progress,
                                                const std::function<RayDropTrainState()>& state)>;

/// Trains a ray-drop network on images of equal shape. The same seed gives a
/// bit-identical network on the same device.
/// @param resume_state state of a training with the same images, options and seed, or
/// null
/// @throws DataError if the images have different shapes, are too small, are not finite
/// or have no dropped pixels, or if `resume_state` belongs to another training
/// @throws DeviceError if the device cannot run the layers of the network
RayDropNetwork train_drop_network(Device& device, const std::vector<RayDropImage>& images,
                                  const RayDropNetworkOptions& options, std::uint64_t seed,
                                  const RayDropTrainCallback& progress,
                                  const RayDropTrainState* resume_state = nullptr);

class RayDropInference;

/// Applies a trained ray-drop network to images. The same image always gives the same
/// result.
class RayDropRefiner {
public:
    /// Uploads the network to the device.
    /// @throws DataError if the arrays do not match the shape of the network
    /// @throws DeviceError if the device cannot run the layers of the network
    RayDropRefiner(Device& device, const RayDropNetwork& network);
    ~RayDropRefiner();
    RayDropRefiner(RayDropRefiner&&) noexcept;
    RayDropRefiner& operator=(RayDropRefiner&&) noexcept;

    const RayDropNetwork& network() const;
    /// Returns the drop probability of each pixel, [rows, columns].
    /// @throws DataError if the image is too small, or has the wrong number of values or
    /// values that are not finite
    std::vector<float> predict_drops(const RayDropImage& image);
    /// Returns the total time of each kernel so far, in milliseconds, by kernel name.
    /// Empty if the device has no timestamps.
    const KernelTimes& times() const;
    /// Returns an object that applies the network to images on the device, without copies
    /// to the host.
    RayDropInference& inference();

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
