// Copyright 2026 debris_scanner maintainers
//
// Licensed under the Apache License, Version 2.0 (the "License");
// you may not use this file except in compliance with the License.
// You may obtain a copy of the License at
//
//     http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software
// distributed under the License is distributed on an "AS IS" BASIS,
// WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
// See the License for the specific language governing permissions and
// limitations under the License.

// PCL's own figures for the bench: pcl_peers stages|pairs FOLDER, or lum FOLDER OUTER EDGES NAME.
#include "peers.h"

#include <ctime>
#include <fstream>
#include <iostream>
#include <sstream>

Cloud::Ptr read_cloud(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) throw std::runtime_error("cannot read " + path);
  Cloud::Ptr cloud(new Cloud);
  float p[3];
  while (file.read(reinterpret_cast<char*>(p), sizeof(p))) cloud->push_back(pcl::PointXYZ(p[0], p[1], p[2]));
  cloud->is_dense = false;
  return cloud;
}

std::vector<Eigen::Matrix4f> read_poses(const std::string& path) {
  std::ifstream file(path);
  if (!file) throw std::runtime_error("cannot read " + path);
  std::vector<Eigen::Matrix4f> poses;
  std::string line;
  while (std::getline(file, line)) {
    std::istringstream numbers(line);
    Eigen::Matrix4f T;
    for (int r = 0; r < 4; ++r)
      for (int c = 0; c < 4; ++c) numbers >> T(r, c);
    poses.push_back(T);
  }
  return poses;
}

double cpu_ms() {
  timespec t;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return t.tv_sec * 1e3 + t.tv_nsec * 1e-6;
}

std::vector<double> repeat(int times, const std::function<void()>& task) {
  std::vector<double> ms;
  for (int k = 0; k < times; ++k) {
    const double start = cpu_ms();
    task();
    ms.push_back(cpu_ms() - start);
  }
  return ms;
}

void report(const std::string& name, const std::vector<double>& ms, const std::string& more) {
  std::cout << "{\"name\": \"" << name << "\", \"ms\": [";
  for (std::size_t k = 0; k < ms.size(); ++k) std::cout << (k ? ", " : "") << ms[k];
  std::cout << "]" << (more.empty() ? "" : ", ") << more << "}" << std::endl;
}

std::string json(const std::vector<Eigen::Matrix4f>& poses) {
  std::ostringstream text;
  text.precision(9);
  text << "[";
  for (std::size_t k = 0; k < poses.size(); ++k) {
    text << (k ? ", [" : "[");
    for (int n = 0; n < 16; ++n) text << (n ? ", " : "") << poses[k](n / 4, n % 4);
    text << "]";
  }
  text << "]";
  return text.str();
}

int main(int argc, char** argv) {
  const std::vector<std::string> args(argv + 1, argv + argc);
  try {
    if (args.size() == 3 && args[0] == "stages") {
      stages(args[1], std::stoi(args[2]));
    } else if (args.size() == 2 && args[0] == "pairs") {
      pairs(args[1]);
    } else if (args.size() == 5 && args[0] == "lum") {
      lum(args[1], std::stoi(args[2]), args[3], args[4]);
    } else {
      std::cerr << "usage: pcl_peers stages FOLDER TIMES | pairs FOLDER | lum FOLDER OUTER EDGES NAME\n";
      return 2;
    }
  } catch (const std::exception& error) {
    std::cerr << error.what() << "\n";
    return 1;
  }
  return 0;
}
