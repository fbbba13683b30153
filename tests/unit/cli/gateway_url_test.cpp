#include "gateway_url.h"

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include "bus/file_descriptor.h"

namespace splatbus::cli {
namespace {

/// A socket that listens on a port of its own on loopback.
class TakenPort {
 public:
  TakenPort() : socket_(::socket(AF_INET, SOCK_STREAM, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t bytes = sizeof address;
    ::bind(socket_.get(), reinterpret_cast<sockaddr*>(&address), bytes);
    ::listen(socket_.get(), 1);
    ::getsockname(socket_.get(), reinterpret_cast<sockaddr*>(&address), &bytes);
    port_ = ntohs(address.sin_port);
  }
  [[nodiscard]] std::uint16_t port() const { return port_; }
  void release() { socket_.reset(); }

 private:
  bus::FileDescriptor socket_;
  std::uint16_t port_ = 0;
};

LaunchFile file_with(const std::string& gateway) {
  return parse_launch_file("services:\n  - name: bus\n" + gateway, "x.yaml");
}

TEST(GatewayUrl, AFreePortIsTaken) {
  TakenPort usual;
  usual.release();
  LaunchFile file = file_with("  - name: gateway\n");
  const auto found = settle_gateway(file, usual.port());
  ASSERT_TRUE(found);
  EXPECT_EQ(found->url, "http://localhost:" + std::to_string(usual.port()));
  EXPECT_FALSE(found->elsewhere);
  EXPECT_EQ(file.services[1].parameters.at("http").value, "127.0.0.1:" + std::to_string(usual.port()));
  EXPECT_EQ(invitation(*found), "open " + found->url + " in a browser");
}

TEST(GatewayUrl, WhereThePortIsTakenAnotherIsAndItIsSaid) {
  const TakenPort usual;
  LaunchFile file = file_with("  - {name: door, program: splatbus-gateway}\n");
  const auto found = settle_gateway(file, usual.port());
  ASSERT_TRUE(found);
  EXPECT_TRUE(found->elsewhere);
  EXPECT_NE(found->url, "http://localhost:" + std::to_string(usual.port()));
  EXPECT_EQ("http://localhost:" + file.services[1].parameters.at("http").value.substr(10), found->url);
  EXPECT_NE(invitation(*found).find("(port 7680 is taken)"), std::string::npos);
}

TEST(GatewayUrl, AnAddressOfTheFilesOwnStays) {
  LaunchFile file = file_with("  - name: gateway\n    parameters: {http: \"0.0.0.0:443\", certificate: c, key: k}\n");
  EXPECT_EQ(settle_gateway(file)->url, "https://localhost:443");
  EXPECT_EQ(file.services[1].parameters.at("http").value, "0.0.0.0:443");
  LaunchFile named = file_with("  - name: gateway\n    parameters: {http: \"10.0.0.7:80\"}\n");
  EXPECT_EQ(settle_gateway(named)->url, "http://10.0.0.7:80");
}

TEST(GatewayUrl, AFileWithoutAGatewayHasNone) {
  LaunchFile file = file_with("");
  EXPECT_FALSE(settle_gateway(file));
}

}  // namespace
}  // namespace splatbus::cli
