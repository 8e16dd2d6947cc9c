// SPDX-License-Identifier: Apache-2.0
// relidar_bench_embree renders the image of `relidar-dev bench` with Embree on the host.
// The time is a reference for ray traversal in software. Surfels, rays, order and
// blending are the same (docs/method.md M1-M5, Eq. 2-4), in single precision on two
// threads. An intersection filter inserts each hit into a sorted buffer of `chunk` hits.
// If the buffer is full, the filter shortens the ray.
#if __has_include(<embree4/rtcore.h>)
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <ctime>
#include <limits>
#include <thread>
#include <vector>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <relidar/log/sensor.hpp>
#include <relidar/scene/scene.hpp>
#include "base/sigmoid.hpp"
#include "scene/benchmark_street.hpp"

namespace {

using namespace relidar;

#if RTC_VERSION_MAJOR >= 4
using Context = RTCRayQueryContext;
#else
using Context = RTCIntersectContext;
#endif

constexpr int kMaxChunk = 64, kMaxPasses = 4096;
// The quad around each surfel is enlarged by this factor and distance (AccelOptions).
constexpr float kQuadScale = 1.002f, kPad_m = 1e-4f;

/// The axes are divided by the scales, so (u, v) of a point counts standard deviations.
struct SurfelGeometry {
    glm::vec3 mean;
    float opacity;
    glm::vec3 axis_u, axis_v, normal;
};

struct EmbreeHit {
    float t, alpha;
    unsigned surfel;
};

bool is_nearer(const EmbreeHit& first, const EmbreeHit& second) {
    return first.t != second.t ? first.t < second.t : first.surfel < second.surfel;
}

struct EmbreeSceneData {
    ImageModel model;
    std::vector<SurfelGeometry> records;
    std::vector<float> sh;
};

/// State of a ray while it searches its next hits. The context must be the first member,
/// because Embree passes only its address to the filter callback.
struct RayQueryState {
    Context context;
    const EmbreeSceneData* world;
    glm::vec3 origin, direction;
    EmbreeHit after;
    int chunk;
    int n = 0;
    EmbreeHit hits[kMaxChunk];

    /// Tests a surfel and inserts its hit into the list of the nearest `chunk` hits,
    /// sorted by distance. Ignores hits up to `after`, the last hit of the previous pass.
    /// At (u, v) in the plane of the surfel, alpha = opacity exp(-(u^2 + v^2) / 2).
    void test_surfel(unsigned surfel_index) {
        const SurfelGeometry& shape = world->records[surfel_index];
        const glm::vec3 to_mean = shape.mean - origin;
        const float t = glm::dot(shape.normal, to_mean) / glm::dot(shape.normal, direction);
        if (n == chunk && t > hits[n - 1].t) return;
        const glm::vec3 hit_from_mean = t * direction - to_mean;
        const float u = glm::dot(shape.axis_u, hit_from_mean), v = glm::dot(shape.axis_v, hit_from_mean);
        const EmbreeHit hit{t, shape.opacity * std::exp(-0.5f * (u * u + v * v)), surfel_index};
        if (!(hit.alpha >= world->model.alpha_min) || !is_nearer(after, hit)) return;
        int slot = n;
        while (slot > 0 && is_nearer(hit, hits[slot - 1])) --slot;
        // Ignores a second hit of the same surfel. Embree splits a quad into two
        // triangles, so a ray can hit both.
        if (slot == chunk || (slot > 0 && hits[slot - 1].surfel == surfel_index)) return;
        n = std::min(n + 1, chunk);
        std::copy_backward(hits + slot, hits + n - 1, hits + n);
        hits[slot] = hit;
    }
    /// Returns the distance behind which no hit can enter the list. The margin covers
    /// rounding of Embree's distances.
    float search_end() const {
        return n == chunk ? hits[n - 1].t + 1e-4f + 1e-5f * hits[n - 1].t
                          : std::numeric_limits<float>::infinity();
    }
};

/// Filter function that Embree calls for each quad that a ray hits.
void collect_hit(const RTCFilterFunctionNArguments* filter_arguments) {
    RayQueryState& query = *reinterpret_cast<RayQueryState*>(filter_arguments->context);
    query.test_surfel(RTCHitN_primID(filter_arguments->hit, 1, 0));
    // Embree does not search behind an accepted hit. So this callback rejects the nearest
    // `chunk` hits, which `query` stores, and accepts a hit behind these.
    filter_arguments->valid[0] = RTCRayN_tfar(filter_arguments->ray, 1, 0) > query.search_end() ? -1 : 0;
}

/// Evaluates the 16 real spherical harmonics up to degree 3
/// (shaders/scene/gaussian/sh.glsl).
/// @param basis_values output, 16 numbers
void sh_basis(const glm::vec3& direction, float* basis_values) {
    const float x = direction.x, y = direction.y, z = direction.z, xx = x * x, yy = y * y, zz = z * z;
    const float values[16] = {0.28209479f,
                              -0.48860251f * y,
                              0.48860251f * z,
                              -0.48860251f * x,
                              1.09254843f * x * y,
                              -1.09254843f * y * z,
                              0.31539157f * (2 * zz - xx - yy),
                              -1.09254843f * x * z,
                              0.54627422f * (xx - yy),
                              -0.59004359f * y * (3 * xx - yy),
                              2.89061144f * x * y * z,
                              -0.45704580f * y * (4 * zz - xx - yy),
                              0.37317633f * z * (2 * zz - 3 * xx - 3 * yy),
                              -0.45704580f * x * (4 * zz - xx - yy),
                              1.44530572f * z * (xx - yy),
                              -0.59004359f * x * (xx - 3 * yy)};
    std::copy(values, values + 16, basis_values);
}

struct RenderedPixel {
    float depth = 0, weight = 0, intensity = 0, hit_logit = 0, drop_logit = 0, transmittance = 1;
    unsigned n_hits = 0;
};

class EmbreeRenderer {
public:
    EmbreeRenderer(const Surfels& surfels, int chunk, const std::string& build_threads)
        : device_(rtcNewDevice(build_threads.c_str())), scene_(rtcNewScene(device_)), chunk_(chunk) {
        world_.sh = surfels.sh;
        const RTCGeometry mesh = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_QUAD);
        auto* corners = static_cast<glm::vec3*>(rtcSetNewGeometryBuffer(
            mesh, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, sizeof(glm::vec3), 4 * surfels.size()));
        auto* indices = static_cast<unsigned*>(rtcSetNewGeometryBuffer(
            mesh, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT4, 4 * sizeof(unsigned), surfels.size()));
        for (std::size_t i = 0; i < surfels.size(); ++i) add_surfel_quad(surfels, i, corners + 4 * i);
        for (unsigned i = 0; i < 4 * surfels.size(); ++i) indices[i] = i;
        rtcSetGeometryIntersectFilterFunction(mesh, collect_hit);
        rtcSetGeometryBuildQuality(mesh, RTC_BUILD_QUALITY_HIGH);
        rtcCommitGeometry(mesh);
        rtcAttachGeometry(scene_, mesh);
        rtcReleaseGeometry(mesh);
        rtcSetSceneBuildQuality(scene_, RTC_BUILD_QUALITY_HIGH);
        rtcCommitScene(scene_);
    }
    ~EmbreeRenderer() {
        rtcReleaseScene(scene_);
        rtcReleaseDevice(device_);
    }
    EmbreeRenderer(const EmbreeRenderer&) = delete;
    EmbreeRenderer& operator=(const EmbreeRenderer&) = delete;

    /// Renders a ray front to back. Each pass finds the next `chunk` hits and blends
    /// them, until the ray is opaque or has no more hits.
    RenderedPixel render_ray(const glm::vec3& origin, const glm::vec3& direction) const {
        RayQueryState query;
        query.world = &world_;
        query.origin = origin;
        query.direction = direction;
        query.chunk = chunk_;
        query.after = {world_.model.near_m, 0.0f, ~0u};
        float basis[16];
        sh_basis(direction, basis);
        RenderedPixel pixel;
        for (int pass = 0; pass < kMaxPasses; ++pass) {
            find_next_hits(query);
            for (int i = 0; i < query.n; ++i)
                if (!blend_hit(query.hits[i], basis, pixel)) return add_background(pixel);
            if (query.n < query.chunk) return add_background(pixel);
            query.after = query.hits[query.n - 1];
        }
        return pixel;
    }

private:
    RTCDevice device_;
    RTCScene scene_;
    int chunk_;
    EmbreeSceneData world_;

    /// Adds a surfel and stores the corners of its quad. The quad contains all points
    /// with an opacity of at least alpha_min. They are at most k standard deviations from
    /// the centre: opacity exp(-k^2 / 2) = alpha_min.
    void add_surfel_quad(const Surfels& surfels, std::size_t surfel_index, glm::vec3* output_corners) {
        const glm::vec4 q = surfels.rotation[surfel_index];
        const glm::mat3 axes = glm::mat3_cast(glm::normalize(glm::quat(q[0], q[1], q[2], q[3])));
        const glm::vec2 scale = glm::exp(surfels.log_scale[surfel_index]);
        const float opacity = sigmoid(surfels.opacity_logit[surfel_index]);
        world_.records.push_back(
            {surfels.mean[surfel_index], opacity, axes[0] / scale.x, axes[1] / scale.y, axes[2]});
        const float k = std::sqrt(2.0f * std::log(std::max(opacity / world_.model.alpha_min, 1.0f)));
        const glm::vec3 half_edge_u = (k * scale.x * kQuadScale + kPad_m) * axes[0],
                        half_edge_v = (k * scale.y * kQuadScale + kPad_m) * axes[1];
        const glm::vec3 mean = surfels.mean[surfel_index];
        output_corners[0] = mean - half_edge_u - half_edge_v;
        output_corners[1] = mean + half_edge_u - half_edge_v;
        output_corners[2] = mean + half_edge_u + half_edge_v;
        output_corners[3] = mean - half_edge_u + half_edge_v;
    }

    /// Searches the next hits behind `after`, with a margin for rounding by Embree.
    void find_next_hits(RayQueryState& query) const {
        query.n = 0;
        RTCRayHit target{};
        target.ray.org_x = query.origin.x;
        target.ray.org_y = query.origin.y;
        target.ray.org_z = query.origin.z;
        target.ray.dir_x = query.direction.x;
        target.ray.dir_y = query.direction.y;
        target.ray.dir_z = query.direction.z;
        target.ray.tnear = std::max(0.0f, query.after.t - (1e-4f + 1e-5f * query.after.t));
        target.ray.tfar = std::numeric_limits<float>::infinity();
        target.ray.mask = ~0u;
        target.hit.geomID = RTC_INVALID_GEOMETRY_ID;
        target.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
#if RTC_VERSION_MAJOR >= 4
        rtcInitRayQueryContext(&query.context);
        RTCIntersectArguments arguments;
        rtcInitIntersectArguments(&arguments);
        arguments.context = &query.context;
        rtcIntersect1(scene_, &target, &arguments);
#else
        rtcInitIntersectContext(&query.context);
        rtcIntersect1(scene_, &query.context, &target);
#endif
    }

    /// Blends a hit into a pixel.
    /// @return false if the ray is already opaque, so that the hit is invisible
    bool blend_hit(const EmbreeHit& hit, const float* sh_basis_values, RenderedPixel& pixel) const {
        const float alpha = std::min(hit.alpha, world_.model.alpha_max),
                    next_transmittance = pixel.transmittance * (1.0f - alpha);
        if (next_transmittance < world_.model.transmittance_min) return false;
        const float weight = alpha * pixel.transmittance;
        const float* coefficients = world_.sh.data() + std::size_t(kShFloats) * hit.surfel;
        // Intensity, hit logit and drop logit: 0.5 plus a sum over 16 coefficients.
        float channel[3] = {0.5f, 0.5f, 0.5f};
        for (int c = 0; c < 3; ++c)
            for (int k = 0; k < 16; ++k) channel[c] += sh_basis_values[k] * coefficients[16 * c + k];
        pixel.depth += weight * hit.t;
        pixel.weight += weight;
        pixel.intensity += weight * std::max(channel[0], 0.0f);
        pixel.hit_logit += weight * channel[1];
        pixel.drop_logit += weight * channel[2];
        pixel.transmittance = next_transmittance;
        ++pixel.n_hits;
        return true;
    }

    static RenderedPixel add_background(RenderedPixel pixel) {
        pixel.drop_logit += pixel.transmittance;  // Adds the background, which has a drop logit of 1.
        return pixel;
    }
};

/// Renders all rays on several threads. A shared counter assigns them blocks of rays.
std::vector<RenderedPixel> render_rays(const EmbreeRenderer& renderer, const RayTable& rays, int n_threads) {
    constexpr std::size_t kRaysPerBlock = 256;
    std::vector<RenderedPixel> image(rays.size());
    std::atomic<std::size_t> next_block{0};
    const auto take_block = [&] { return kRaysPerBlock * next_block++; };
    const auto render_blocks = [&] {
        for (std::size_t begin = take_block(); begin < image.size(); begin = take_block()) {
            const std::size_t end = std::min(begin + kRaysPerBlock, image.size());
            for (std::size_t i = begin; i < end; ++i)
                image[i] = renderer.render_ray(rays.origin[i], rays.direction[i]);
        }
    };
    // This thread is one of them.
    std::vector<std::thread> threads;
    for (int i = 1; i < n_threads; ++i) threads.emplace_back(render_blocks);
    render_blocks();
    for (std::thread& thread : threads) thread.join();
    return image;
}

double cpu_time_s() { return double(std::clock()) / CLOCKS_PER_SEC; }

RayTable make_named_rays(const std::string& rays_name) {
    int rows = 0, columns = 0;
    if (std::sscanf(rays_name.c_str(), "%dx%d", &rows, &columns) == 2)
        return make_street_rays(rows, columns, 2.0, -24.9);
    return make_street_rays(rays_name);
}

}  // namespace

int main(int argc, char** argv) {
    CLI::App app(
        "renders a benchmark street with Embree and prints one line: Mrays/s by wall time, Mrays/s by "
        "processor time, blended hits per ray, mean depth");
    std::string scene = "A", rays_name = "64x1024";
    unsigned n_surfels = 100000;
    int chunk = 16, repeat = 10, n_threads = 2;
    app.add_option("--scene", scene, "benchmark street: A or B")->check(CLI::IsMember({"A", "B"}));
    app.add_option("--surfels", n_surfels, "number of surfels of the street")
        ->check(CLI::Range(1u, 50000000u));
    app.add_option("--rays", rays_name, "size of the image: waymo, kitti or ROWSxCOLUMNS");
    app.add_option("--chunk", chunk, "number of hits that are sorted together")
        ->check(CLI::Range(1, kMaxChunk));
    app.add_option("--repeat", repeat, "number of measured images")->check(CLI::Range(1, 10000));
    app.add_option("--threads", n_threads, "number of threads")->check(CLI::Range(1, 256));
    CLI11_PARSE(app, argc, argv);

    const EmbreeRenderer renderer(make_street_surfels(n_surfels, 20261120, scene == "B"), chunk,
                                  fmt::format("threads={}", n_threads));
    const RayTable rays = make_named_rays(rays_name);
    std::vector<RenderedPixel> image = render_rays(renderer, rays, n_threads);  // Warm-up run, not timed.
    std::vector<double> wall, cpu;
    for (int i = 0; i < repeat; ++i) {
        const auto start = std::chrono::steady_clock::now();
        const double cpu_start = cpu_time_s();
        image = render_rays(renderer, rays, n_threads);
        cpu.push_back((cpu_time_s() - cpu_start) / n_threads);
        wall.push_back(std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
    }
    std::sort(wall.begin(), wall.end());
    std::sort(cpu.begin(), cpu.end());
    double n_hits = 0.0, depth = 0.0;
    for (const RenderedPixel& pixel : image) {
        n_hits += pixel.n_hits;
        depth += pixel.depth;
    }
    const double mrays = 1e-6 * double(rays.size()), n = double(rays.size());
    fmt::print("{:.4f} {:.4f} {:.3f} {:.6f}\n", mrays / wall[wall.size() / 2], mrays / cpu[cpu.size() / 2],
               n_hits / n, depth / n);
    return 0;
}
