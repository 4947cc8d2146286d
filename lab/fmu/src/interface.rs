//! The C interface of FMI 3.0.

#![allow(unsafe_code, reason = "an interface for C")]
#![allow(non_snake_case, reason = "the names are those of the standard")]

use std::{
    borrow::Cow,
    ffi::{CStr, CString, c_char, c_void},
    panic::{AssertUnwindSafe, catch_unwind},
    ptr, slice,
};

use crate::{
    instance::{Failure, Instance, Status, fail},
    variables::{Unit, Value, Variable},
};

/// The importer's function for messages: its environment, status, category and text.
type Log = Option<unsafe extern "C" fn(*mut c_void, Status, *const c_char, *const c_char)>;

/// What an importer has of an instance.
struct Handle {
    /// None after a panic.
    instance: Option<Instance>,
    environment: *mut c_void,
    log: Log,
}

/// Tells the importer why a call was not obeyed.
fn tell(log: Log, environment: *mut c_void, call: &str, failure: &Failure) {
    let text = CString::new(format!("{call}: {}", failure.1)).unwrap_or_default();
    if let Some(log) = log {
        // SAFETY: the importer's function takes its own environment, and texts for the call.
        unsafe {
            log(environment, failure.0, c"error".as_ptr(), text.as_ptr());
        }
    }
}

/// Makes a call of an instance. A panic breaks the instance, and does not reach the importer.
///
/// # Safety
///
/// `handle` is null or from [`fmi3InstantiateCoSimulation`], and not freed.
unsafe fn call(
    handle: *mut Handle,
    name: &str,
    work: impl FnOnce(&mut Instance) -> Result<(), Failure>,
) -> Status {
    // SAFETY: as the caller promises; calls of one instance do not overlap, by the standard.
    let Some(handle) = (unsafe { handle.as_mut() }) else {
        return Status::Error;
    };
    let instance = handle.instance.as_mut();
    let answer = instance.map(|it| catch_unwind(AssertUnwindSafe(|| work(it))));
    let failure = match answer {
        Some(Ok(Ok(()))) => return Status::Ok,
        Some(Ok(Err(failure))) => failure,
        Some(Err(_)) | None => {
            handle.instance = None;
            let text = "the simulation panicked, see stderr: free the instance";
            Failure(Status::Fatal, text.to_owned())
        }
    };
    tell(handle.log, handle.environment, name, &failure);
    failure.0
}

/// Functions of an instance.
macro_rules! functions {
    ($($name:ident($($argument:ident: $type:ty),*) |$instance:ident| $work:expr;)+) => {$(
        #[unsafe(no_mangle)]
        unsafe extern "C" fn $name(handle: *mut Handle, $($argument: $type),*) -> Status {
            // SAFETY: the importer passes what the standard asks for.
            unsafe { call(handle, stringify!($name), |$instance| $work) }
        }
    )+};
}

/// Functions that get and set the values of a type.
macro_rules! accessors {
    ($($get:ident $set:ident $type:ty: $value:ident => $kind:pat => $got:expr, $made:expr;)+) => {
        functions! {$(
            $get(references: *const u32, n: usize, values: *mut $type, m: usize) |instance| {
                let references = array(references, n, m)?;
                for (index, reference) in references.iter().enumerate() {
                    match instance.get(*reference)? {
                        $kind => *values.add(index) = $got,
                        other => {
                            let (kind, asked) = (other.kind(), stringify!($get));
                            let Variable(name, ..) = instance.variable(*reference)?;
                            fail!(Error, "{name} is a {kind}: call fmi3Get{kind}, not {asked}");
                        }
                    }
                }
                Ok(())
            };
            $set(references: *const u32, n: usize, values: *const $type, m: usize) |instance| {
                let references = array(references, n, m)?;
                for (index, reference) in references.iter().enumerate() {
                    let $value = *values.add(index);
                    instance.set(*reference, $made)?;
                }
                Ok(())
            };
        )+}
    };
}

/// The references of a call, each of one value.
///
/// # Safety
///
/// There are `count` of them.
unsafe fn array<'a>(
    references: *const u32,
    count: usize,
    values: usize,
) -> Result<&'a [u32], Failure> {
    if count != values {
        fail!(
            Error,
            "{values} values for {count} variables: every variable has one"
        );
    }
    if count == 0 {
        return Ok(&[]);
    }
    // SAFETY: as the caller promises.
    Ok(unsafe { slice::from_raw_parts(references, count) })
}

/// The value of a text.
///
/// # Safety
///
/// `text` is null, or one of C.
unsafe fn text(text: *const c_char) -> Result<Value, Failure> {
    if text.is_null() {
        fail!(Error, "a text is missing: give an empty one");
    }
    // SAFETY: as the caller promises.
    let text = unsafe { CStr::from_ptr(text) };
    Ok(Value::Text(Cow::Owned(text.to_owned())))
}

accessors! {
    fmi3GetFloat64 fmi3SetFloat64 f64: it => Value::Number(it) => *it, Value::Number(it);
    fmi3GetUInt64 fmi3SetUInt64 u64: it => Value::Count(it) => *it, Value::Count(it);
    fmi3GetBoolean fmi3SetBoolean bool: it => Value::Flag(it) => *it, Value::Flag(it);
    fmi3GetString fmi3SetString *const c_char: it => Value::Text(it) => it.as_ptr(),
        text(it)?;
}

functions! {
    fmi3EnterInitializationMode(_tolerates: bool, _tolerance: f64, start: f64, _stops: bool, _stop: f64)
        |instance| { instance.start(start); Ok(()) };
    fmi3ExitInitializationMode() |instance| instance.set_up();
    fmi3Reset() |instance| { instance.reset(); Ok(()) };
    fmi3Terminate() |_instance| Ok(());
    fmi3SetDebugLogging(_on: bool, _count: usize, _categories: *const *const c_char) |_instance| Ok(());
    fmi3DoStep(
        time: f64, step: f64, _keeps: bool, event: *mut bool, ends: *mut bool, early: *mut bool, reached: *mut f64
    ) |instance| {
        (*event, *ends, *early, *reached) = (false, false, false, time);
        instance.step(time, step)?;
        *reached = time + step;
        Ok(())
    };
}

/// Functions of the standard that the description does not offer.
macro_rules! not_offered {
    ($($name:ident)+) => {functions! {$(
        $name() |_instance| { fail!(Error, "not offered: see modelDescription.xml") };
    )+}};
}

not_offered! {
    fmi3ActivateModelPartition fmi3CompletedIntegratorStep fmi3DeserializeFMUState
    fmi3EnterConfigurationMode fmi3EnterContinuousTimeMode fmi3EnterEventMode fmi3EnterStepMode
    fmi3EvaluateDiscreteStates fmi3ExitConfigurationMode fmi3FreeFMUState fmi3GetAdjointDerivative fmi3GetBinary
    fmi3GetClock fmi3GetContinuousStateDerivatives fmi3GetContinuousStates
    fmi3GetDirectionalDerivative fmi3GetEventIndicators fmi3GetFloat32 fmi3GetFMUState fmi3GetInt16 fmi3GetInt32
    fmi3GetInt64 fmi3GetInt8 fmi3GetIntervalDecimal fmi3GetIntervalFraction
    fmi3GetNominalsOfContinuousStates fmi3GetNumberOfContinuousStates fmi3GetNumberOfEventIndicators
    fmi3GetNumberOfVariableDependencies fmi3GetOutputDerivatives fmi3GetShiftDecimal
    fmi3GetShiftFraction fmi3GetUInt16 fmi3GetUInt32 fmi3GetUInt8 fmi3GetVariableDependencies
    fmi3SerializeFMUState fmi3SerializedFMUStateSize fmi3SetBinary fmi3SetClock
    fmi3SetContinuousStates fmi3SetFMUState fmi3SetFloat32 fmi3SetInt16 fmi3SetInt32 fmi3SetInt64 fmi3SetInt8
    fmi3SetIntervalDecimal fmi3SetIntervalFraction fmi3SetShiftDecimal fmi3SetShiftFraction
    fmi3SetTime fmi3SetUInt16 fmi3SetUInt32 fmi3SetUInt8 fmi3UpdateDiscreteStates
}

#[unsafe(no_mangle)]
extern "C" fn fmi3GetVersion() -> *const c_char {
    c"3.0".as_ptr()
}

/// Makes an instance of the unit with this token; null if there is none.
#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3InstantiateCoSimulation(
    _name: *const c_char,
    token: *const c_char,
    _resources: *const c_char,
    _visible: bool,
    _logging: bool,
    _events: bool,
    _early: bool,
    _intermediate: *const u32,
    _intermediate_count: usize,
    environment: *mut c_void,
    log: Log,
    _update: *const c_void,
) -> *mut Handle {
    // SAFETY: the importer passes a text; null is none.
    let token = (!token.is_null()).then(|| unsafe { CStr::from_ptr(token) });
    let token = token.unwrap_or_default().to_string_lossy();
    let Some(unit) = Unit::ALL.into_iter().find(|unit| unit.token() == token) else {
        let known = Unit::ALL.map(Unit::token).join(" or ");
        let text = format!("the token is {token:?}: this library is {known}");
        let failure = Failure(Status::Error, text);
        tell(log, environment, "fmi3InstantiateCoSimulation", &failure);
        return ptr::null_mut();
    };
    Box::into_raw(Box::new(Handle {
        instance: Some(Instance::new(unit)),
        environment,
        log,
    }))
}

#[unsafe(no_mangle)]
extern "C" fn fmi3InstantiateModelExchange() -> *mut c_void {
    ptr::null_mut()
}

#[unsafe(no_mangle)]
extern "C" fn fmi3InstantiateScheduledExecution() -> *mut c_void {
    ptr::null_mut()
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3FreeInstance(handle: *mut Handle) {
    if !handle.is_null() {
        // SAFETY: it is from `fmi3InstantiateCoSimulation`, and freed once.
        drop(unsafe { Box::from_raw(handle) });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_breaks_the_instance_and_stays_inside() {
        let mut handle = Handle {
            instance: Some(Instance::new(Unit::Car)),
            environment: ptr::null_mut(),
            log: None,
        };
        let mut made = |work: fn(&mut Instance) -> Result<(), Failure>| {
            // SAFETY: the handle is one.
            unsafe { call(&raw mut handle, "fmi3DoStep", work) }
        };
        assert_eq!(made(|_| Ok(())), Status::Ok);
        assert_eq!(made(|_| panic!("as a test")), Status::Fatal);
        assert_eq!(made(|_| Ok(())), Status::Fatal);
    }

    #[test]
    fn a_null_in_place_of_the_token_gives_no_instance() {
        let null = ptr::null();
        // SAFETY: no argument is read but the token.
        let handle = unsafe {
            fmi3InstantiateCoSimulation(
                null,
                null,
                null,
                false,
                false,
                false,
                false,
                ptr::null(),
                0,
                ptr::null_mut(),
                None,
                ptr::null(),
            )
        };
        assert!(handle.is_null());
    }
}
