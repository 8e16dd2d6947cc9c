// SPDX-License-Identifier: Apache-2.0
#include "server.hpp"

#include <cstdlib>
#include <fstream>
#include <iterator>

#include <google/protobuf/stubs/common.h>
#include <grpc/support/log.h>
#include <grpcpp/ext/proto_server_reflection_plugin.h>
#include <grpcpp/grpcpp.h>
#include <grpcpp/health_check_service_interface.h>
#include <grpcpp/resource_quota.h>

#include "base/fail.hpp"

#include "acceptor.hpp"
#include "asset_catalogue.hpp"
#include "render_requests.hpp"
#include "sensorsim_service.hpp"
#include "service.hpp"

namespace relidar::serve {
namespace {

// The largest sensor has 30 bytes per ray and needs less.
constexpr int kLargestRequest = 40 << 20;
// For calls that do not render.
constexpr std::size_t kOtherThreads = 32;
// A client that does not answer a ping has vanished.
constexpr int kPingInterval_ms = 20'000;
// Until a new connection starts to use gRPC.
constexpr int kHandshakeTimeout_ms = 10'000;
// Time in which gRPC writes a response after its call has returned.
constexpr std::chrono::milliseconds kLastWrites{200};
// Without calls. After this time, the client must connect again.
constexpr int kLongestIdle_ms = 600'000;

std::string read_pem_file(const std::string& file_path) {
    std::ifstream in(file_path, std::ios::binary);
    std::string text((std::istreambuf_iterator<char>(in)), std::istreambuf_iterator<char>());
    if (text.find("-----BEGIN") == std::string::npos)
        fail("cannot read {}: it contains no PEM data, expected a certificate or a key", file_path);
    return text;
}

/// Turns off the logs of gRPC and Protobuf on stderr. gRPC only repeats errors that
/// relidar reports. Protobuf prints a line for each invalid UTF-8 text, so any client
/// could fill the disk.
void silence_grpc() {
    if (std::getenv("GRPC_VERBOSITY")) return;
    gpr_set_log_function([](gpr_log_func_args*) {});
#if GOOGLE_PROTOBUF_VERSION < 4022000
    google::protobuf::SetLogHandler(nullptr);
#endif
}

}  // namespace

struct ScanServer::Impl {
    RenderQueue queue;
    std::optional<AssetCatalogue> assets;
    /// Only the render thread creates, uses and destroys the device and the scenes.
    std::optional<Device> device;
    std::optional<SceneSet> scenes;
    std::optional<RenderService> service;
    std::vector<std::unique_ptr<SensorsimService>> sensorsim;  ///< one for each name
    std::optional<Acceptor> acceptor;
    std::unique_ptr<grpc::experimental::ExternalConnectionAcceptor> connections;
    std::unique_ptr<grpc::Server> server;

    explicit Impl(std::size_t waiting) : queue(waiting) {}
    ~Impl() {
        if (acceptor) acceptor->stop();
        if (server) server->Shutdown(std::chrono::system_clock::now());
        server.reset();
        run_function([&] {
            scenes.reset();
            device.reset();
        });
    }

    void run_function(const std::function<void()>& function) { queue.reserve_slot()->run_function(function); }
    void start_listening(const ServerOptions& options);
    void set_health(bool is_serving);
};

/// Returns the certificate of the server, or no encryption if the user has given none.
std::shared_ptr<grpc::ServerCredentials> server_credentials(const ServerOptions& options) {
    if (options.tls_cert.empty()) return grpc::InsecureServerCredentials();
    grpc::SslServerCredentialsOptions tls;
    tls.pem_key_cert_pairs.push_back({read_pem_file(options.tls_key), read_pem_file(options.tls_cert)});
    return grpc::SslServerCredentials(tls);
}

/// Starts the gRPC server. Accepts connections with an Acceptor, because gRPC stops
/// permanently when no file descriptor is free.
void ScanServer::Impl::start_listening(const ServerOptions& options) {
    silence_grpc();
    // Opens the sockets first, to report an unusable address before gRPC starts threads.
    acceptor.emplace(options.listen);

    // Sets the limits of the server.
    grpc::EnableDefaultHealthCheckService(true);
    grpc::reflection::InitProtoReflectionServerBuilderPlugin();
    grpc::ResourceQuota quota("relidar");
    // One thread for each call that waits in the queue, and threads for other calls.
    quota.SetMaxThreads(int(queue.total_slots() + kOtherThreads));
    grpc::ServerBuilder builder;
    builder.SetResourceQuota(quota);
    builder.SetMaxReceiveMessageSize(kLargestRequest);
    builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIME_MS, kPingInterval_ms);
    builder.AddChannelArgument(GRPC_ARG_SERVER_HANDSHAKE_TIMEOUT_MS, kHandshakeTimeout_ms);
    builder.AddChannelArgument(GRPC_ARG_MAX_CONNECTION_IDLE_MS, kLongestIdle_ms);

    // Starts the services. The acceptor passes them each connection as a file descriptor.
    using ConnectionSource = grpc::ServerBuilder::experimental_type::ExternalConnectionType;
    connections = builder.experimental().AddExternalConnectionAcceptor(ConnectionSource::FROM_FD,
                                                                       server_credentials(options));
    builder.RegisterService(&*service);
    for (const auto& named : sensorsim) builder.RegisterService(named.get());
    server = builder.BuildAndStart();
    if (!server)
        fail<UsageError>("cannot listen at {}: the gRPC server does not start{}", options.listen,
                         options.tls_cert.empty() ? "" : ", expected a certificate that matches its key");
    set_health(true);
    acceptor->start_accepting([this](int listener, int connection) {
        grpc::experimental::ExternalConnectionAcceptor::NewConnectionParameters accepted;
        accepted.listener_fd = listener;
        accepted.fd = connection;
        connections->HandleNewConnection(&accepted);
    });
}

void ScanServer::Impl::set_health(bool is_serving) {
    grpc::HealthCheckServiceInterface& health = *server->GetHealthCheckService();
    health.SetServingStatus(v1::RenderService::service_full_name(), is_serving);
    if (!sensorsim.empty())
        for (const char* name : SensorsimService::kNames) health.SetServingStatus(name, is_serving);
    // The empty name means the complete server in the gRPC health protocol.
    if (!is_serving) health.SetServingStatus("", false);
}

/// Loads all runs on the render thread, because only that thread may use the device. Then
/// starts to listen for connections.
ScanServer::ScanServer(const ServerOptions& options) : impl_(std::make_unique<Impl>(options.waiting)) {
    std::vector<SceneSource> sources = parse_sources(options.runs, options.channels, options.weather);
    impl_->assets.emplace(options.assets);
    impl_->run_function([&] {
        impl_->device.emplace(options.device);
        const std::uint64_t scene_memory_bytes =
            options.memory_mib > 0 ? options.memory_mib << 20 : impl_->device->info().memory_bytes / 2;
        impl_->scenes.emplace(*impl_->device, std::move(sources), scene_memory_bytes, *impl_->assets);
    });
    // Batches are useful only if the device renders several scans at the same time.
    if (ScanRenderer::default_parallel(*impl_->device) > 1) impl_->queue.set_batch_size(kBatchSize);
    impl_->service.emplace(impl_->queue, *impl_->scenes);
    // Old and new clients of NVIDIA's interface call the same service by different names.
    if (options.sensorsim)
        for (const char* name : SensorsimService::kNames)
            impl_->sensorsim.push_back(
                std::make_unique<SensorsimService>(name, impl_->queue, *impl_->scenes, *options.sensorsim));
    impl_->start_listening(options);
}

ScanServer::~ScanServer() = default;

int ScanServer::port() const { return impl_->acceptor->port(); }
const std::string& ScanServer::device_name() const { return impl_->device->info().name; }

std::vector<std::string> ScanServer::list_scenes() const {
    std::vector<std::string> names;
    for (const SceneSource& source : impl_->scenes->sources()) names.push_back(source.name);
    return names;
}

std::optional<std::string> ScanServer::loss_message() {
    const std::optional<std::string> loss = impl_->queue.loss_message();
    if (loss) impl_->set_health(false);
    return loss;
}

/// Rejects new calls and waits for pending calls. Reports NOT_SERVING first, so that
/// clients that check the health stop calling.
void ScanServer::stop_and_wait(std::chrono::milliseconds max_wait) {
    const auto end = std::chrono::system_clock::now() + max_wait;
    impl_->acceptor->stop();
    impl_->server->GetHealthCheckService()->SetServingStatus(false);
    // Shutdown() waits until each client has read the responses that gRPC has written
    // before. It closes a connection immediately after later responses. If the client
    // then sends a byte, the system resets the connection, and responses can be lost.
    impl_->queue.drain(max_wait);
    std::this_thread::sleep_for(kLastWrites);
    impl_->server->Shutdown(end);
}

}  // namespace relidar::serve
