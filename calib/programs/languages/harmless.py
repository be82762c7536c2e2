"""Instructions and functions of controllers that change no target, tool, frame or mode of motion.

They are those of the manufacturers' manuals that take the values of their arguments and set none of them. A name that
is not here, and that the program does not declare, may change anything.
"""

from __future__ import annotations


def names(text: str, *, fold_case: bool = False) -> frozenset[str]:
    """Return the names in a text, in capitals where case does not count."""
    return frozenset((text.upper() if fold_case else text).split())


URSCRIPT = names("""
    abs acos asin atan atan2 assert binary_list_to_integer ceil cos d2r floor get_list_length integer_to_binary_list
    interpolate_pose inv length log norm normalize point_dist pose_add pose_dist pose_inv pose_sub pose_trans pow
    quaternion_to_rotvec r2d random rotvec2rpy rpy2rotvec sin size sqrt struct tan transpose wrench_trans
    str_at str_cat str_empty str_find str_len str_sub to_num to_str
    enter_critical exit_critical get_steptime popup request_boolean_from_primary_client
    request_float_from_primary_client request_integer_from_primary_client request_string_from_primary_client sleep
    sync textmsg powerdown time
    get_actual_joint_positions get_actual_joint_positions_history get_actual_joint_speeds get_actual_tcp_pose
    get_actual_tcp_speed get_actual_tool_flange_pose get_controller_temp get_conveyor_tick_count get_forward_kin
    get_inverse_kin get_inverse_kin_has_solution get_joint_temp get_joint_torques get_target_joint_positions
    get_target_joint_speeds get_target_payload get_target_payload_cog get_target_payload_inertia get_target_tcp_pose
    get_target_tcp_speed get_target_waypoint get_tcp_force get_tcp_offset get_tool_accelerometer_reading
    get_tool_current get_tcp get_jacobian get_mass_matrix
    is_steady is_within_safety_limits force stopj stopl end_freedrive_mode end_force_mode end_teach_mode
    zero_ftsensor set_payload set_payload_mass set_payload_cog set_target_payload set_gravity
    tool_contact get_freedrive_status
    get_analog_in get_analog_out get_configurable_digital_in get_configurable_digital_out get_digital_in
    get_digital_out get_euromap_input get_euromap_output get_flag get_standard_analog_in get_standard_analog_out
    get_standard_digital_in get_standard_digital_out get_tool_analog_in get_tool_digital_in get_tool_digital_out
    get_tool_output_mode
    set_analog_inputrange set_analog_out set_analog_outputdomain set_configurable_digital_input_action
    set_configurable_digital_out set_digital_out set_euromap_output set_euromap_runstate_dependent_choice set_flag
    set_gp_boolean_input_action set_input_actions_to_default set_runstate_configurable_digital_output_to_value
    set_runstate_gp_boolean_output_to_value set_runstate_standard_analog_output_to_value
    set_runstate_standard_digital_output_to_value set_runstate_tool_digital_output_to_value
    set_safety_mode_transition_hardness set_standard_analog_input_domain set_standard_analog_out
    set_standard_digital_input_action set_standard_digital_out set_tool_analog_input_domain
    set_tool_communication set_tool_digital_input_action set_tool_digital_out set_tool_digital_output_mode
    set_tool_output_mode set_tool_voltage set_watchdog
    modbus_add_rtu_signal modbus_add_signal modbus_delete_signal modbus_get_error modbus_get_signal_status
    modbus_get_time_since_signal_invalid modbus_send_custom_command modbus_set_digital_input_action
    modbus_set_output_register modbus_set_output_signal modbus_set_runstate_dependent_choice
    modbus_set_signal_update_frequency modbus_set_signal_watchdog
    read_input_boolean_register read_input_float_register read_input_integer_register read_output_boolean_register
    read_output_float_register read_output_integer_register read_port_bit read_port_register
    write_output_boolean_register
    write_output_float_register write_output_integer_register write_port_bit write_port_register
    rpc_factory rtde_set_watchdog socket_close socket_get_var socket_open socket_read_ascii_float
    socket_read_binary_integer socket_read_byte_list socket_read_line socket_read_string socket_send_byte
    socket_send_int socket_send_line socket_send_string socket_set_var socket_send_bytes
    eoat_enable
   and or xor not run join kill
""")

RAPID = names(
    """
    AccSet ActEventBuffer AliasIO AliasIOReset Break BrakeCheck
    CancelLoad CheckProgRef CirPathMode ClearIOBuff ClearPath ClearRawBytes ClkReset ClkStart ClkStop Close
    CloseDir CopyFile CopyRawBytes CornerPathWarning CorrClear CyclicBrakeCheck DeactEventBuffer DitherAct
    DitherDeact ErrLog ErrRaise ErrWrite GetGroupSignalInfo GripLoad IDelete IDisable IEnable IError InvertDO
    IOBusStart IOBusState IODisable IOEnable IPers ISignalAI ISignalAO ISignalDI ISignalDO ISignalGI ISignalGO ISleep
    ITimer IVarValue IWatch MakeDir MotionProcessModeSet MotionSup Open OpenDir PackDNHeader PackRawBytes PathAccLim
    PathLengthReset PathLengthStart PathLengthStop PathRecStart PathRecStop PathResol ProcerrRecovery PulseDO
    RaiseToUser RemoveDir RemoveFile RenameFile Reset ResetPPMoved ResetRetryCount RestoPath Rewind RMQEmptyQueue
    RMQSendMessage SCWrite Set SetAO SetDO SetGO SingArea SkipWarn SocketAccept SocketBind SocketClose
    SocketConnect SocketCreate SocketListen SocketSend SocketSendTo SoftElbow SpeedLimAxis SpeedLimCheckPoint
    SpeedRefresh SpyStart SpyStop StartMove StartMoveRetry StopMove StopMoveReset StorePath SystemStopAction
    TestSignDefine TestSignReset TextTabInstall TPErase TPShow TPWrite TriggCheckIO TriggDataCopy TriggDataReset
    TriggEquip TriggInt TriggIO TriggRampAO TriggSpeed TriggStopProc TryInt TuneReset     UIMsgWriteAbort VelSet
    WaitAI WaitAO WaitDI WaitDO WaitGI WaitGO WaitLoad WaitRob WaitSyncTask WaitTime
    WaitUntil WorldAccLim Write WriteAnyBin WriteBin WriteBlock WriteRawBytes WriteStrBin WriteVar WZBoxDef WZCylDef
    WZDisable WZDOSet WZEnable WZFree WZHomeJointDef WZLimJointDef WZLimSup WZSphDef ArcRefresh ConsoleWrite Stop
    Abs AbsDnum ACos ACosDnum AInput AOutput ArgName ASin ASinDnum ATan ATanDnum ATan2 ATan2Dnum BitAnd BitAndDnum
    BitCheck BitCheckDnum BitLSh BitLShDnum BitNeg BitNegDnum BitOr BitOrDnum BitRSh BitRShDnum BitXOr BitXOrDnum
    ByteToStr CalcJointT CalcRobT CalcRotAxFrameZ CalcRotAxisFrame CDate CJointT ClkRead CorrRead Cos CosDnum CPos
    CRobT CrossProd CSpeedOverride CTime CTool CWObj DecToHex DefAccFrame DefDFrame DefFrame Dim DInput Distance
    DnumToNum DnumToStr DotProd DOutput EulerZYX EventType ExecHandler ExecLevel Exp FileSize FileTime FSSize GetTime
    GetTaskName GInput GInputDnum GOutput GOutputDnum GetMecUnitName GetMotorTorque GetSysInfo HexToDec IndInpos
    IndSpeed IOUnitState IsFile IsMechUnitActive IsPers IsStopMoveAct IsStopStateEvent IsSyncMoveOn IsSysId IsVar Max
    MaxRobSpeed Min MirPos ModExist ModTime NonMotionMode NOrient NumToDnum NumToStr Offs OpMode OrientZYX ORobT
    ParIdPosValid ParIdRobValid PathLengthGet PathLevel PFRestart PoseInv PoseMult PoseVect Pow PowDnum PPMovedInManMode
    Present ProgMemFree Rand RawBytesLen ReadBin ReadDir ReadMotor ReadStr ReadStrBin RelTool RemainingRetries
    RobName RobOS Round RoundDnum RunMode Sin SinDnum SocketGetStatus SocketPeek Sqrt SqrtDnum StrDigCalc StrDigCmp
    StrFind StrFormat StrLen StrMap StrMatch StrMemb StrOrder StrPart StrToByte Tan TanDnum TaskRunMec
    TaskRunRob TestAndSet TestDI TestSignRead Trunc TruncDnum Type UIClientExist     ValidIO ValToStr VectMagn
    AND OR XOR NOT DIV MOD
""",
    fold_case=True,
)

RAPID_SETS = names(
    """
    Add Incr Decr Clear BitSet BitClear BookErrNo UIMsgBox UIMsgWrite UIShow StrToVal UIAlphaEntry UIDnumEntry
    UIDnumTune UIListView UIMessageBox UINumEntry UINumTune ReadNum TPReadNum TPReadDnum TPReadFK ReadRawBytes ReadBlock
    ReadAnyBin ReadErrData ReadVar ReadVarArr ReadCfgData UnpackRawBytes SocketReceive SocketReceiveFrom GetTrapData
    GetJointData GetDataVal GetSysData IVarValue MatrixSolve MatrixSolveQR MatrixSVD FitCircle LoadId ManLoadIdProc
    MToolTCPCalib MToolRotCalib SToolTCPCalib SToolRotCalib STCalib CamGetParameter CamGetResult RMQGetMessage
    RMQGetMsgData RMQGetMsgHeader RMQReadWait RMQSendWait RMQFindSlot WaitTestAndSet GetNextSym
""",
    fold_case=True,
)
"""Those that set some of their arguments, and nothing else."""

KRL = names("""
    ABS SIN COS ACOS TAN ATAN ATAN2 SQRT FORWARD INVERSE INV_POS PULSE STRADD STRCLEAR STRCOMP STRFIND STRLEN
    STRDECLLEN VARSTATE VARTYPE GETVARSIZE IS_KEY_PRESSED TIMER_LIMIT SYNCCMD CANCELPROGSYNC MAX MIN ROUND
    B_NOT B_AND B_OR B_EXOR AND OR NOT EXOR
    IR_STOPM EXISTS_KRLMSG ISMESSAGESET WSPACEGIVE WSPACETAKE
    HALT CONTINUE ANIN ANOUT DIGIN IMPORT
    $VEL $VEL_AXIS $ACC $ACC_AXIS $APO $JERK $GEAR_JERK $ORI_TYPE $CIRC_TYPE $CIRC_MODE $ADVANCE $OUT $OUTB $ANOUT
    $OV_PRO $OV_APPL $OV_ROB $LOAD $LOAD_A1 $LOAD_A2 $LOAD_A3 $BWDSTART $H_POS $TIMER $TIMER_STOP $TIMER_FLAG $FLAG
    $CYCFLAG $ACT_TOOL $ACT_BASE $ACT_TOOL_C $ACT_BASE_C $VEL_EXTAX $ACC_EXTAX $DECEL_MB $STOPMB_ID $ERR_RAISE
    $SPL_VEL_MODE $TECH_OUT
""")
"""Functions and statements of KRL, and the system variables that may be set without moving anything elsewhere."""

BAS_HARMLESS = names("#VEL_PTP #VEL_CP #ACC_PTP #ACC_CP #PTP_DAT #CP_DAT #ORI_TYPE #CIRC_TYPE")
BAS_FORMS = names("#FRAMES #PTP_PARAMS #CP_PARAMS")

FANUC = names("""
    R DO RO GO AO DI RI GI AI F M SO SI TIMER SR AR OVERRIDE PAYLOAD WAIT PAUSE RSR UALM MESSAGE REMARK
    SKIP OFFSET TOOL_OFFSET LOCK UNLOCK COL JOINT_MAX_SPEED LINEAR_MAX_SPEED TC_ONLINE RESUME_PROG ERROR_PROG
""")
"""Registers, outputs and instructions of FANUC. An offset's condition counts only in motions with that offset."""
