// SPDX-License-Identifier: Apache-2.0
// Implements traversal with Embree on a two-level scene with two bounding triangles per
// surfel (M3). The filter callback intersects the surfel of every triangle along the ray
// (M1, M2) and keeps the nearest `chunk` hits. Embree's t only shortens the ray, with a
// margin of twice the largest triangle pair. Each moving model has a separate scene,
// where the ray is traced in the model's frame at its time.
#if __has_include(<embree4/rtcore.h>)
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <stdexcept>
#include <string>

#include "traversal.hpp"

namespace relidar::reference {
namespace {

#if RTC_VERSION_MAJOR >= 4
using Context = RTCRayQueryContext;
#else
using Context = RTCIntersectContext;
#endif

// Maximum half size in metres. With this limit, vertices are far below the limit of
// Embree (1.8e18).
constexpr double kMaxHalfSize = 1e5;

template <typename Handle, void (*release)(Handle)>
struct Released {
    Handle handle = nullptr;
    explicit Released(Handle h) : handle(h) {}
    Released(Released&& other) noexcept : handle(other.handle) { other.handle = nullptr; }
    Released(const Released&) = delete;
    Released& operator=(const Released&) = delete;
    ~Released() {
        if (handle != nullptr) release(handle);
    }
};
using Device = Released<RTCDevice, rtcReleaseDevice>;
using SceneHandle = Released<RTCScene, rtcReleaseScene>;
using Geometry = Released<RTCGeometry, rtcReleaseGeometry>;

void check(RTCDevice device, const char* description) {
    const RTCError error = rtcGetDeviceError(device);
    if (error != RTC_ERROR_NONE)
        throw std::runtime_error(std::string(description) + ": Embree error " + std::to_string(int(error)));
}

bool all_finite(const FloatRecord& record) {
    const float* values = &record.mean.x;
    static_assert(offsetof(FloatRecord, primitive) == 13 * sizeof(float));
    return std::all_of(values, values + 13, [](float value) { return std::isfinite(value); });
}

/// Corners of a surfel's proxy in the order (-,-) (+,-) (+,+) (-,+).
struct Quad {
    glm::dvec3 corner[4];
    double radius;
};

Quad make_proxy(const Surfel& surfel, const ImageModel& model, const ProxyMargin& margin) {
    const Activated a = activate(surfel);
    const double k = std::sqrt(2.0 * std::max(0.0, std::log(a.opacity / double(model.alpha_min))));
    const glm::dvec2 half = glm::min(k * a.scale * margin.scale + margin.pad_m, glm::dvec2(kMaxHalfSize));
    const glm::dvec3 u = half.x * a.rotation[0], v = half.y * a.rotation[1];
    return {{a.mean - u - v, a.mean + u - v, a.mean + u + v, a.mean - u + v}, glm::length(half)};
}

}  // namespace

struct EmbreeFilter::State {
    /// Bottom-level scene of a model: triangles 2i and 2i + 1 belong to surfel ids[i].
    struct ModelScene {
        SceneHandle scene;
        std::vector<std::uint32_t> ids;
    };

    State(const World& world, const ImageModel& image_model, const ProxyMargin& margin);
    ModelScene build_model(const World& world, const Placement& placement, const ProxyMargin& margin);
    void fill(RTCGeometry mesh, const World& world, const std::vector<std::uint32_t>& ids,
              const ProxyMargin& margin);
    void place(std::uint32_t instance, RTCScene model_scene, const Pose& world_from_model);

    ImageModel model;
    std::vector<FloatRecord> records;
    std::vector<FloatRows> rows;
    std::vector<Placement> instances;
    // an Embree scene for each instance, although instances may share a model; this is
    // simple, and tests have few instances
    std::vector<ModelScene> models;
    double t_margin = 1e-3;
    Device device{rtcNewDevice("threads=1,set_affinity=0")};
    SceneHandle top{rtcNewScene(device.handle)};
};

namespace {

/// Data that the filter callback uses. Embree passes a pointer to the context, which must
/// therefore be the first member.
struct Query {
    Context context;
    const FloatRecord* records;
    const ImageModel* model;
    const std::vector<std::uint32_t>* const* ids;  // [instance]
    const LocalRay<float>* local;                  // [instance]
    HitKey after;
    std::size_t chunk;
    double t_margin;
    std::vector<Hit>* hits;
    // index of the moving instance whose separate scene is being traced
    std::uint32_t moving = RTC_INVALID_GEOMETRY_ID;

    /// Inserts a candidate into the sorted buffer if it is a hit, not yet in the buffer,
    /// and among the nearest hits.
    void offer(std::uint32_t instance, std::uint32_t triangle) {
        const std::uint32_t surfel = (*ids[instance])[triangle / 2];
        const auto hit = intersect_in_float(records[surfel], local[instance], *model);
        if (!hit) return;
        const Hit key{double(hit->t), instance, surfel};
        if (!(after < key)) return;
        const auto at = std::lower_bound(hits->begin(), hits->end(), key);
        // the surfel was already found through its other triangle
        if (at != hits->end() && *at == key) return;
        hits->insert(at, key);
        if (hits->size() > chunk) hits->pop_back();
    }
    bool may_shorten(double t_embree) const {
        return hits->size() == chunk && t_embree > hits->back().t + t_margin;
    }
};

void on_candidate(const RTCFilterFunctionNArguments* args) {
    if (args->valid[0] != -1) return;
    Query& query = *reinterpret_cast<Query*>(args->context);
    const std::uint32_t instance = RTCHitN_instID(args->hit, args->N, 0, 0);
    query.offer(instance == RTC_INVALID_GEOMETRY_ID ? query.moving : instance,
                RTCHitN_primID(args->hit, args->N, 0));
    args->valid[0] = query.may_shorten(RTCRayN_tfar(args->ray, args->N, 0)) ? -1 : 0;
}

}  // namespace

EmbreeFilter::State::State(const World& world, const ImageModel& image_model, const ProxyMargin& margin)
    : model(image_model) {
    for (const Surfel& s : world.surfels) records.push_back(make_float_record(s));
    rtcSetSceneFlags(top.handle, RTC_SCENE_FLAG_ROBUST);
    for (std::uint32_t i = 0; i < world.instances.size(); ++i) {
        const Placement& p = world.instances[i];
        rows.push_back(make_model_from_world_rows(p.world_from_model));
        instances.push_back(p);
        models.push_back(build_model(world, p, margin));
        if (!models.back().ids.empty() && p.motion.is_none())
            place(i, models.back().scene.handle, p.world_from_model);
    }
    rtcCommitScene(top.handle);
    check(device.handle, "EmbreeFilter");
}

EmbreeFilter::State::ModelScene EmbreeFilter::State::build_model(const World& world,
                                                                 const Placement& placement,
                                                                 const ProxyMargin& margin) {
    ModelScene result{SceneHandle(rtcNewScene(device.handle)), {}};
    for (std::uint32_t s = placement.first; s < placement.first + placement.count; ++s)
        if (all_finite(records[s]) && records[s].sigma > model.alpha_min) result.ids.push_back(s);
    if (result.ids.empty()) return result;
    rtcSetSceneFlags(result.scene.handle, RTC_SCENE_FLAG_ROBUST);
    const Geometry mesh(rtcNewGeometry(device.handle, RTC_GEOMETRY_TYPE_TRIANGLE));
    fill(mesh.handle, world, result.ids, margin);
    rtcSetGeometryIntersectFilterFunction(mesh.handle, on_candidate);
    rtcCommitGeometry(mesh.handle);
    rtcAttachGeometry(result.scene.handle, mesh.handle);
    rtcCommitScene(result.scene.handle);
    return result;
}

void EmbreeFilter::State::fill(RTCGeometry mesh, const World& world, const std::vector<std::uint32_t>& ids,
                               const ProxyMargin& margin) {
    const auto new_buffer = [&](RTCBufferType type, RTCFormat format, std::size_t count) {
        void* data = rtcSetNewGeometryBuffer(mesh, type, 0, format, 12, count);
        check(device.handle, "EmbreeFilter: buffer");
        return data;
    };
    auto* vertex = static_cast<float*>(new_buffer(RTC_BUFFER_TYPE_VERTEX, RTC_FORMAT_FLOAT3, 4 * ids.size()));
    auto* index =
        static_cast<std::uint32_t*>(new_buffer(RTC_BUFFER_TYPE_INDEX, RTC_FORMAT_UINT3, 2 * ids.size()));
    for (std::uint32_t i = 0; i < ids.size(); ++i) {
        const Quad quad = make_proxy(world.surfels[ids[i]], model, margin);
        t_margin = std::max(t_margin, 2.0 * quad.radius + 1e-3);
        for (const glm::dvec3& corner : quad.corner)
            for (int axis = 0; axis < 3; ++axis) *vertex++ = float(corner[axis]);
        for (const std::uint32_t corner : {0u, 1u, 2u, 0u, 2u, 3u}) *index++ = 4 * i + corner;
    }
}

void EmbreeFilter::State::place(std::uint32_t instance, RTCScene model_scene, const Pose& world_from_model) {
    const Geometry geometry(rtcNewGeometry(device.handle, RTC_GEOMETRY_TYPE_INSTANCE));
    rtcSetGeometryInstancedScene(geometry.handle, model_scene);
    const glm::mat4x3 matrix(to_matrix(world_from_model));
    rtcSetGeometryTransform(geometry.handle, 0, RTC_FORMAT_FLOAT3X4_COLUMN_MAJOR, &matrix[0][0]);
    rtcCommitGeometry(geometry.handle);
    rtcAttachGeometryByID(top.handle, geometry.handle, instance);
}

EmbreeFilter::EmbreeFilter(const World& world, const ImageModel& model, ProxyMargin margin)
    : state_(std::make_unique<State>(world, model, margin)) {}

EmbreeFilter::~EmbreeFilter() = default;

namespace {

/// Traces a ray through a scene. Embree passes the candidate triangles to the query.
void search(RTCScene scene, const LocalRay<float>& ray, float near_m, Query& query) {
    RTCRayHit target{};
    target.ray.org_x = ray.origin.x;
    target.ray.org_y = ray.origin.y;
    target.ray.org_z = ray.origin.z;
    target.ray.dir_x = ray.direction.x;
    target.ray.dir_y = ray.direction.y;
    target.ray.dir_z = ray.direction.z;
    target.ray.tnear = near_m;
    target.ray.tfar = std::numeric_limits<float>::infinity();
    target.ray.mask = ~0u;
    target.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    target.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
#if RTC_VERSION_MAJOR >= 4
    rtcInitRayQueryContext(&query.context);
    RTCIntersectArguments arguments;
    rtcInitIntersectArguments(&arguments);
    arguments.context = &query.context;
    rtcIntersect1(scene, &target, &arguments);
#else
    rtcInitIntersectContext(&query.context);
    rtcIntersect1(scene, &query.context, &target);
#endif
}

}  // namespace

void EmbreeFilter::find_next_hits(const Ray& ray, const HitKey& after, int chunk,
                                  std::vector<Hit>& hits) const {
    hits.clear();
    std::vector<LocalRay<float>> local;
    std::vector<const std::vector<std::uint32_t>*> ids;
    const glm::vec3 origin(ray.origin), direction(ray.direction);
    // converts the margin from metres to t, whose unit is the length of the direction
    const double t_margin = state_->t_margin / glm::length(ray.direction);
    for (std::size_t i = 0; i < state_->rows.size(); ++i) {
        const Placement& p = state_->instances[i];
        local.push_back(
            follow(to_model(state_->rows[i], origin, direction), p.world_from_model, p.motion, ray.time_s));
        ids.push_back(&state_->models[i].ids);
    }
    Query query{{},    state_->records.data(), &state_->model, ids.data(), local.data(),
                after, std::size_t(chunk),     t_margin,       &hits};
    const float t_near = float(std::max(0.0, after.t - t_margin));
    search(state_->top.handle, {origin, direction}, t_near, query);
    for (std::uint32_t i = 0; i < local.size(); ++i) {
        if (state_->instances[i].motion.is_none() || ids[i]->empty()) continue;
        query.moving = i;
        search(state_->models[i].scene.handle, local[i], t_near, query);
    }
}

}  // namespace relidar::reference
