//! Opening devices by name.

use burn::tensor::{Device, Tensor};
use kinegrad_kernels::{Mode, VARIABLE};
use kinegrad_settings::InvalidSetting;

/// A kind of device compiled into this build.
pub struct Kind {
    /// The value of `run.device` that selects this kind.
    pub name: &'static str,
    /// A description.
    pub description: &'static str,
    /// True if a machine may have several such devices, each with an index.
    indexed: bool,
    open: fn(index: usize) -> Device,
}

impl Kind {
    /// The name of the device of this index.
    fn name_of(&self, index: usize) -> String {
        match (self.indexed, index) {
            (true, 1..) => format!("{}:{index}", self.name),
            _ => self.name.to_string(),
        }
    }
}

/// The kinds in order of preference; `auto` takes the first that works.
const KINDS: &[Kind] = &[
    #[cfg(feature = "cuda")]
    Kind {
        name: "cuda",
        description: "NVIDIA GPU; cuda:1 is the second",
        indexed: true,
        open: |index| Device::cuda(index),
    },
    #[cfg(feature = "metal")]
    Kind {
        name: "metal",
        description: "Apple GPU",
        indexed: false,
        open: |_| Device::metal(burn::tensor::DeviceKind::DefaultDevice),
    },
    #[cfg(feature = "vulkan")]
    Kind {
        name: "vulkan",
        description: "GPU through Vulkan and SPIR-V",
        indexed: false,
        open: |_| Device::vulkan(burn::tensor::DeviceKind::DefaultDevice),
    },
    #[cfg(feature = "wgpu")]
    Kind {
        name: "wgpu",
        description: "GPU through wgpu and WGSL",
        indexed: false,
        open: |_| Device::wgpu(burn::tensor::DeviceKind::DefaultDevice),
    },
    Kind {
        name: "cpu",
        description: "CPU, Burn's Flex backend",
        indexed: false,
        open: |_| Device::flex(),
    },
    #[cfg(feature = "ndarray")]
    Kind {
        name: "ndarray",
        description: "CPU, Burn's NdArray backend (deprecated there)",
        indexed: false,
        open: |_| {
            // Burn deprecates this backend; it serves for comparison while Burn has it.
            #[allow(deprecated)]
            Device::ndarray()
        },
    },
];

/// True if the device `name` computes on the CPU, in main memory.
pub(crate) fn is_host(name: &str) -> bool {
    ["cpu", "ndarray"].iter().any(|host| name.starts_with(host))
}

/// A description of the CPU kernels.
pub fn kernels() -> &'static str {
    match Mode::from_environment() {
        Ok(Mode::Composed) => "networks on the CPU run as Burn's operations",
        _ => "networks on the CPU run as kinegrad's own kernels",
    }
}

/// The kinds of device in this build, best first, and true for each kind that works on this
/// machine.
pub fn list() -> impl Iterator<Item = (&'static Kind, bool)> {
    KINDS.iter().map(|kind| (kind, works(kind, 0).is_some()))
}

/// Opens the device `name`: `auto` for the best working device, a kind, or a kind with an index
/// such as `cuda:1`. Returns the device and its resolved name.
///
/// # Errors
/// If the device is missing or fails, or the environment names unknown kernels.
pub fn open(name: &str) -> Result<(Device, String), InvalidSetting> {
    open_for(name, 0)
}

/// [`open`] for process `local` of a machine; each process takes a separate device of a kind.
pub(crate) fn open_for(name: &str, local: usize) -> Result<(Device, String), InvalidSetting> {
    Mode::from_environment().map_err(|error| {
        let found = format!("\"{}\" in the environment", error.found);
        InvalidSetting::new(VARIABLE, found, "\"fused\" or \"composed\"").hint(
            "\"fused\", which it is without the variable, runs networks on the CPU as kinegrad's \
             own kernels; \"composed\" runs Burn's operations",
        )
    })?;
    let refuse = |reason: String| {
        let kinds: Vec<&str> = KINDS.iter().map(|kind| kind.name).collect();
        let allowed = format!("{} in this build", kinds.join(", "));
        InvalidSetting::new("run.device", format!("\"{name}\""), allowed).hint(reason)
    };
    let own = |kind: &Kind| {
        let too_few = format!(
            "process {local} of this machine, counted from 0, finds no free device `{}`: start no more \
             processes on a machine than it has cards",
            kind.name
        );
        own(kind, local).ok_or_else(|| refuse(too_few))
    };
    if name == "auto" {
        return KINDS
            .iter()
            .filter_map(|kind| works(kind, 0).map(|device| (kind, device)))
            .find(|(_, device)| !is_software(device))
            .ok_or_else(|| refuse("no device works on this machine".into()))
            .and_then(|(kind, _)| own(kind));
    }
    let (kind_name, index) = match name.split_once(':') {
        Some((kind, index)) => {
            let index = index.parse::<usize>();
            let index = index.map_err(|_| refuse("the index after `:` is not a number".into()))?;
            (kind, Some(index))
        }
        None => (name, None),
    };
    let Some(kind) = KINDS.iter().find(|kind| kind.name == kind_name) else {
        let features = ["ndarray", "wgpu", "vulkan", "metal", "cuda"];
        return Err(refuse(if features.contains(&kind_name) {
            format!(
                "this build has no such device; build with option `features {kind_name}`, or take another, \
                 such as option `device cpu`"
            )
        } else {
            "there is no such device".into()
        }));
    };
    let fails = || refuse("the machine has no such device, or its driver fails".into());
    match index {
        None if local > 0 => own(kind),
        _ => {
            let device = works(kind, index.unwrap_or(0)).ok_or_else(fails)?;
            Ok((device, name.to_string()))
        }
    }
}

/// The device with index `local`, or the only device that the launcher shows to the process.
fn own(kind: &Kind, local: usize) -> Option<(Device, String)> {
    let index = if kind.indexed { local } else { 0 };
    let found = works(kind, index).map(|device| (device, kind.name_of(index)));
    let alone = || works(kind, 1).is_none().then(|| works(kind, 0)).flatten();
    found.or_else(|| Some((alone()?, kind.name_of(0))))
}

/// The name of a graphics device.
#[cfg(any(
    feature = "wgpu",
    feature = "vulkan",
    feature = "metal",
    feature = "cuda"
))]
pub(crate) fn hardware(device: &Device) -> Option<String> {
    device.identity().map(|identity| identity.name)
}

/// This build has no graphics backend.
#[cfg(not(any(
    feature = "wgpu",
    feature = "vulkan",
    feature = "metal",
    feature = "cuda"
)))]
pub(crate) fn hardware(_: &Device) -> Option<String> {
    None
}

/// True if the device is a software graphics driver, which is far slower than Flex.
fn is_software(device: &Device) -> bool {
    let mut software = ["llvmpipe", "swiftshader", "software"].into_iter();
    let name = hardware(device).unwrap_or_default().to_lowercase();
    software.any(|software| name.contains(software))
}

/// Opens a device and adds two numbers on it; a missing driver panics inside the backend.
fn works(kind: &Kind, index: usize) -> Option<Device> {
    let open = kind.open;
    let quiet = std::panic::take_hook();
    std::panic::set_hook(Box::new(|_| {}));
    let opened = std::panic::catch_unwind(move || {
        let device = open(index);
        let sum = Tensor::<1>::ones([2], &device).add_scalar(1.0);
        (sum.try_into_vec_as::<f32>().ok()? == [2.0, 2.0]).then_some(device)
    });
    std::panic::set_hook(quiet);
    opened.ok().flatten()
}
