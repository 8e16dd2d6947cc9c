// SPDX-License-Identifier: Apache-2.0
// Writes a random scene, its rays, dL/d(rendered), and the image and gradients of the
// double reference. The Python test renders and differentiates the same scene through
// numpy and compares the results. Usage: gradient_fixture OUT.npz ray|surfel
#include <cstdio>
#include <string>

#include <relidar/base/arrays.hpp>

#include "../support/pixel_gradients.hpp"
#include "../support/placed.hpp"
#include "../support/random_scene.hpp"

namespace relidar {
namespace {

constexpr int kChunk = 16;

class Table {
public:
    template <class Vector>
    void add(const std::string& name, const Vector& row, std::size_t count) {
        Column& column = columns_[name];
        column.width = count;
        for (std::size_t k = 0; k < count; ++k) column.values.push_back(double(row[static_cast<int>(k)]));
    }
    void add(const std::string& name, double value) { columns_[name].values.push_back(value); }
    std::vector<NamedArray> arrays() const {
        std::vector<NamedArray> result;
        for (const auto& [name, column] : columns_) {
            std::vector<std::size_t> shape{column.values.size() / std::max<std::size_t>(column.width, 1)};
            if (column.width > 0) shape.push_back(column.width);
            result.push_back(make_array(name, shape, column.values.data(), column.values.size()));
        }
        return result;
    }

private:
    struct Column {
        std::vector<double> values;
        /// Numbers per row. 0 means a single number per row, without a second axis.
        std::size_t width = 0;
    };
    std::map<std::string, Column> columns_;
};

void add_surfel(Table& table, const std::string& prefix, const reference::Surfel& surfel) {
    table.add(prefix + "mean", surfel.mean, 3);
    table.add(prefix + "rotation", surfel.rotation, 4);
    table.add(prefix + "log_scale", surfel.log_scale, 2);
    table.add(prefix + "opacity_logit", surfel.opacity_logit);
    table.add(prefix + "sh", surfel.sh.data(), kShFloats);
}

void add_pixel(Table& table, const reference::Pixel& pixel) {
    table.add("rendered/depth", pixel.depth);
    table.add("rendered/weight", pixel.weight);
    table.add("rendered/intensity", pixel.intensity);
    table.add("rendered/hit_logit", pixel.hit_logit);
    table.add("rendered/drop_logit", pixel.drop_logit);
    table.add("rendered/transmittance", pixel.transmittance);
    table.add("rendered/median_depth", pixel.median_depth);
    table.add("rendered/hits", pixel.hits);
    table.add("rendered/instance", double(pixel.instance));
}

void add_upstream(Table& table, const reference::PixelGradient& gradient) {
    table.add("upstream/depth", gradient.depth);
    table.add("upstream/weight", gradient.weight);
    table.add("upstream/intensity", gradient.intensity);
    table.add("upstream/hit_logit", gradient.hit_logit);
    table.add("upstream/drop_logit", gradient.drop_logit);
}

/// Adds the scene in the form in which Python must create it. The surfels are in the
/// order of `placed`.
void add_scene(Table& table, const test::RandomScene& scene, const test::SceneAndPoses& placed) {
    for (const std::uint32_t i : placed.original) add_surfel(table, "scene/", scene.world.surfels[i]);
    for (const SurfelModel& model : placed.scene.models) {
        table.add("model/first", model.first);
        table.add("model/count", model.count);
    }
    for (std::size_t i = 0; i < placed.scene.instances.size(); ++i) {
        table.add("instance/model", placed.scene.instances[i].model);
        // GLM holds columns
        const glm::dmat4 rows = glm::transpose(to_matrix(placed.world_from_instance[i].world_from_model));
        table.add("instance/pose", &rows[0][0], 16);
    }
    table.add("view_origin", scene.view_origin, 3);
}

void write_fixture(const std::string& path, ShDirection direction) {
    reference::Settings settings;
    settings.image.sh_direction = direction;
    const test::RandomSceneOptions options{// the same options as in DeviceGradient
                                           .seed = 31,
                                           .actor_instances = direction == ShDirection::ray ? 2 : 1,
                                           .rays = 60};
    const test::RandomScene scene = test::make_random_scene(options, settings);
    settings.view_origin = scene.view_origin;
    const test::SceneAndPoses placed =
        test::to_scene(test::to_surfels(scene.world.surfels), scene.world.instances);
    const std::vector<reference::PixelGradient> upstream =
        test::make_random_upstream(scene.rays.size(), options.seed);
    const reference::BruteForce hits(scene.world, settings.image, reference::Precision::double_record);

    Table table;
    add_scene(table, scene, placed);
    reference::Gradients expected(scene.world);
    for (std::size_t i = 0; i < scene.rays.size(); ++i) {
        table.add("ray/origin", scene.rays[i].origin, 3);
        table.add("ray/direction", scene.rays[i].direction, 3);
        add_upstream(table, upstream[i]);
        add_pixel(table, reference::render(scene.world, hits, settings, scene.rays[i], kChunk));
        const reference::RayGradient d_ray =
            reference::backward(scene.world, hits, settings, scene.rays[i], kChunk, upstream[i], expected);
        table.add("gradient/ray_origin", d_ray.origin, 3);
        table.add("gradient/ray_direction", d_ray.direction, 3);
    }
    for (const std::uint32_t i : placed.original) add_surfel(table, "gradient/", expected.surfels[i]);
    for (const reference::PoseGradient& pose : expected.instances) {
        table.add("gradient/pose_translation", pose.translation, 3);
        table.add("gradient/pose_rotation", pose.rotation, 3);
    }
    write_npz(path, table.arrays());
}

}  // namespace
}  // namespace relidar

int main(int n_arguments, char** arguments) {
    if (n_arguments != 3) {
        std::fprintf(stderr, "usage: gradient_fixture OUT.npz ray|surfel\n");
        return 2;
    }
    relidar::write_fixture(arguments[1], arguments[2] == std::string("surfel") ? relidar::ShDirection::surfel
                                                                               : relidar::ShDirection::ray);
    return 0;
}
